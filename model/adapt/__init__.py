"""Adapts the shipped model to a lab's own recordings (`touchd train --extra`)."""
