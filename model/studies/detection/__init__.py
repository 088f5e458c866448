"""Touches detected by a network, beside the daemon's rules."""
