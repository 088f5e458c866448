"""The folder of the pages."""

from pathlib import Path

DOCS = Path(__file__).parents[2] / "docs"
