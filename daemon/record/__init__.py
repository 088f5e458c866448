"""Guided sessions of recordings (`touchd record`, `touchd teach`), and recordings as MCAP."""
