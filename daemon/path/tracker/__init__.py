"""When touches begin and end: the pad's rest, contact, loose wires, and what the network says."""
