"""Measures a model file: scores, arithmetic on hard cases, timing."""
