"""Stand-ins for hardware: a fake serial port, robots on loopback."""
