"""How well touches are detected (docs/sessions.md)."""
