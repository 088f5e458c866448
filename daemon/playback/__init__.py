"""Recordings played as a pad sends them."""
