"""Stand-ins for hardware: a fake serial port, a simulated hand, robots on loopback."""
