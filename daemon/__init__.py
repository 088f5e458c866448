"""The touchd daemon: from frames to touches, answers, events and the robot."""
