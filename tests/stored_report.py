"""The published report: the folder of its page, and its results."""

from __future__ import annotations

from pathlib import Path

from model.study.results import Results

DOCS = Path(__file__).parent.parent / "docs"
RESULTS = Results(DOCS / "report.json")
