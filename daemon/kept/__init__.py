"""Reads the journal back, and keeps the frames of touches."""
