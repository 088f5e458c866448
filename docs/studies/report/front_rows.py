"""What the front is made of: each network at each length with its cost and its error, and who is on it.

Others than ours are timed with random weights. The error of the paper's networks comes from the trainings of
tables 2 and 3 where these went on for as long as the paper's, and else from the paper, which chose its epoch
on test: a training cut short would speak against a network that does better. The error of the challenge's
networks comes from table 1, which has no 81 frames.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from docs.studies.accuracy import PAPER_ACCURACY
from docs.studies.quantize import FLOAT32
from docs.studies.report import challenge_page, table2
from docs.studies.report.challenge_systems import SYSTEMS
from docs.studies.report.networks import CHALLENGE, HUGHES, OURS, PAPER_BLOCKS, SHIPPED
from docs.studies.report.paper_cells import Variant, trained_cells
from docs.studies.report.paper_tables import PAPER_EPOCHS
from docs.studies.report.results import Results

MEASURED = "measured"
PRINTED = "printed in the paper"


@dataclass(frozen=True)
class Error:
    """A macro error, a share from 0 to 1, and where it is from."""

    share: float
    source: str


@dataclass(frozen=True)
class Row:
    """One network over windows of one length.

    processor_ms: median of the thread's processor time, which other work on the machine hardly stretches, and
    so what networks are compared by. eager: in PyTorch, of the paper's in float32.
    """

    name: str
    family: str
    arithmetic: str
    width: int
    blocks: int
    frames: int
    multiply_adds: int
    p50_ms: float
    p99_ms: float
    processor_ms: float
    eager_p50_ms: float | None
    eager_p99_ms: float | None
    eager_processor_ms: float | None
    file_bytes: int
    peak_bytes: int
    error: Error | None

    @property
    def shipped(self) -> bool:
        """Whether this is the file that ships."""
        return (self.name, self.arithmetic) == (SHIPPED, FLOAT32)

    @property
    def title(self) -> str:
        """What tables call the network."""
        if self.shipped:
            return f"touchd, {self.width} wide (shipped)"
        if self.family == OURS:
            return f"touchd, {self.width} wide"
        if self.family == HUGHES:
            return f"Hughes et al., {CHALLENGE[_system(self.name)]}"
        blocks = "1 block" if self.blocks == 1 else f"{self.blocks} blocks"
        code = "as printed" if self.family == "printed" else "as its code has it"
        return f"the paper's, {code}, {blocks}"


def rows(results: Results) -> list[Row]:
    """Return what has been measured, ours first, by width and blocks."""
    found = []
    for key in results.keys("front/"):
        _, name, arithmetic = key.split("/")
        cell = results.get(key)
        for frames, figures in cell["at"].items():
            found.append(_row(results, name, arithmetic, cell, int(frames), figures))
    order = {OURS: 0, HUGHES: 1, "public": 2, "printed": 3}
    return sorted(found, key=lambda row: (order[row.family], row.width, row.blocks, row.frames))


def front(candidates: Sequence[Row]) -> list[Row]:
    """Return those that no other beats in both time and error, fastest first."""
    kept: list[Row] = []
    for row in sorted((row for row in candidates if row.error), key=lambda row: row.processor_ms):
        if row.error and (not kept or row.error.share < _share(kept[-1])):
            kept.append(row)
    return kept


def printed_error(frames: int, blocks: int) -> Error | None:
    """Return the error that the paper prints for a length at its 6 blocks, or for blocks at 144 frames."""
    if blocks == PAPER_BLOCKS and frames in PAPER_ACCURACY:
        return Error(1.0 - PAPER_ACCURACY[frames] / 100, PRINTED)
    if frames == table2.FRAMES:
        mean, _, _ = table2.PAPER[blocks].partition(" ")
        return Error(1.0 - float(mean) / 100, PRINTED)
    return None


def trained_error(results: Results, variant: Variant, frames: int, blocks: int) -> Error | None:
    """Return the error after the last epoch of networks trained here for as long as the paper's."""
    cells = trained_cells(results, variant, blocks, frames)
    if not cells or cells[0].epochs < PAPER_EPOCHS:
        return None
    return _mean_error([results.get(cell.key)["accuracies"][-1] for cell in cells])


def hughes_error(results: Results, system: str, frames: int) -> Error | None:
    """Return the error of a network of the challenge's over windows of this length, from table 1."""
    (found,) = (each for each in SYSTEMS if each.key == system)
    accuracies = challenge_page.measured(results, found, frames, "macro_accuracy")
    return _mean_error(accuracies) if accuracies else None


def _mean_error(accuracies: Sequence[float]) -> Error:
    seeds = "1 seed" if len(accuracies) == 1 else f"{len(accuracies)} seeds"
    return Error(1.0 - float(np.mean(accuracies)), f"trained here, {seeds}")


def _row(
    results: Results, name: str, arithmetic: str, cell: dict[str, Any], frames: int, figures: dict[str, Any]
) -> Row:
    runtime, eager = figures["onnx_runtime"], figures.get("pytorch_eager", {})
    error = None
    if "accuracy" in figures:
        error = Error(1.0 - figures["accuracy"], MEASURED)
    elif arithmetic == FLOAT32 and cell["family"] == HUGHES:
        error = hughes_error(results, _system(name), frames)
    elif arithmetic == FLOAT32:
        trained = trained_error(results, cell["family"], frames, cell["blocks"])
        error = trained or printed_error(frames, cell["blocks"])
    return Row(
        name=name,
        family=cell["family"],
        arithmetic=arithmetic,
        width=cell["width"],
        blocks=cell["blocks"],
        frames=frames,
        multiply_adds=figures["multiply_adds"],
        p50_ms=runtime["p50_ms"],
        p99_ms=runtime["p99_ms"],
        processor_ms=runtime["processor_ms"],
        eager_p50_ms=eager.get("p50_ms"),
        eager_p99_ms=eager.get("p99_ms"),
        eager_processor_ms=eager.get("processor_ms"),
        file_bytes=cell["file_bytes"],
        peak_bytes=cell["peak_bytes"],
        error=error,
    )


def _system(name: str) -> str:
    return name.rsplit("-", 2)[0]


def _share(row: Row) -> float:
    assert row.error is not None
    return row.error.share
