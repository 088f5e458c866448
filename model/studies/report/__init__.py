"""The paper's tables, the challenge's systems, speed against error, what windows and pads cost."""
