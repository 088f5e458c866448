"""Hardware edges and recordings: the ground floor, which imports nothing above it."""
