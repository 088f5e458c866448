"""The daemon in a terminal: the live view, questions, events in words."""
