"""The link to a robot through NAOqi."""
