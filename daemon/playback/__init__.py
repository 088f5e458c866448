"""Recordings played as a pad would send them."""
