"""From unknown bytes to the description of a pad, with a proof; used by `init` and `doctor`."""
