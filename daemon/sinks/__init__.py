"""Where events go: the journal, saved touches, labels and tags."""
