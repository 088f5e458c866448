"""Journals and recordings in the formats that other programs open."""
