"""Files of the daemon: the journal, and the frames of touches."""
