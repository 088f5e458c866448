"""Checks of a model file: its scores, its arithmetic on hard cases, its time."""
