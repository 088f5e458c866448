"""Other systems than the robot: each a sink of its own, imported only when it is configured."""
