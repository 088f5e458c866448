"""Recordings and journals as pictures (`touchd plot`)."""
