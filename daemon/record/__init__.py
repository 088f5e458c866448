"""Recordings of your own: a guided session, and labels for kept touches (`touchd record`)."""
