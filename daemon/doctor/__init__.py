"""The checks of `touchd doctor`."""
