"""What the robot is told: words, reactions, events in its memory."""
