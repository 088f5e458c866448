"""Recordings played as a pad in use, touch after touch, and what the daemon makes of them (docs/touch.md)."""
