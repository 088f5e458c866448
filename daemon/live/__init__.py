"""The live page: what the daemon feels and says, in a browser. Loaded in full only where it is asked for."""
