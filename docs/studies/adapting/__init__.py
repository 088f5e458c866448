"""What adapting to a person gains and costs (docs/adapt.md)."""
