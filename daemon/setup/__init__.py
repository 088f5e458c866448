"""From the settings to the parts that run, and to new ones when the settings change."""
