"""Bridges to systems other than the robot: each is a sink, imported only when it is configured."""
