"""The command, its configuration, and what is wrong in it."""
