"""What the daemon keeps on disk: the journal, and the frames of touches."""
