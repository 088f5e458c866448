"""From YAML text to settings, and from settings to the parts that run."""
