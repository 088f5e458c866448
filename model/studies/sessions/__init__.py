"""Recordings played as a pad in use, touch after touch, and what the daemon says (docs/sessions.md)."""
