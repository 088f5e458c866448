"""Sessions of a pad in use: how they are made, played and scored."""
