"""What runs for each frame: pipeline, tracker, decision, events."""
