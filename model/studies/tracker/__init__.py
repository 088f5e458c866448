"""How well touches are noticed (docs/touch.md)."""
