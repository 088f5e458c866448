"""The detector: a small network that says, frame by frame, whether a hand is on the pad."""
