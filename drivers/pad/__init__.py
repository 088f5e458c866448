"""From a serial line to frames on the model's 54 Hz grid."""
