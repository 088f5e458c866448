"""The published report: the folder of its page, and its results."""

from pathlib import Path

from touchd.model.studies.report.results import Results

DOCS = Path(__file__).parents[2] / "docs"
RESULTS = Results(DOCS / "report.json")
