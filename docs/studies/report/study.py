"""What every part of the study is given to work with."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from docs.studies.report.results import Results


@dataclass(frozen=True)
class Study:
    """haart: folder of recordings; runs: of checkpoints; docs: of the page; threads: of the processor."""

    haart: Path
    runs: Path
    results: Results
    threads: int
    docs: Path

    @property
    def checkpoints(self) -> Path:
        """Where the parts keep what they have half done."""
        return self.runs / "report"
