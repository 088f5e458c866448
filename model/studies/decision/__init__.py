"""How early and how often the daemon is right (docs/decision.md)."""
