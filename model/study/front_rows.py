"""What the front is made of: each network at each length with its cost and its error, and who is on it.

The paper's networks are timed with random weights, so their error comes from the trainings of Tables 2 and 3
where these went on for as long as the paper's, and else from the paper, which chose its epoch on test: a
training cut short would speak against a network that does better.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from model.quantize import FLOAT32
from model.report import PAPER_ACCURACY
from model.study import table2
from model.study.networks import PAPER_BLOCKS, SHIPPED
from model.study.paper_cells import Variant, trained_cells
from model.study.paper_tables import PAPER_EPOCHS
from model.study.results import Results

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
        if self.family == "touchd":
            return f"touchd, {self.width} wide"
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
    order = {"touchd": 0, "public": 1, "printed": 2}
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
    """Return the mean error after the last epoch over the seeds trained here for as long as the paper's."""
    cells = trained_cells(results, variant, blocks, frames)
    if not cells or cells[0].epochs < PAPER_EPOCHS:
        return None
    accuracy = float(np.mean([results.get(cell.key)["accuracies"][-1] for cell in cells]))
    seeds = "1 seed" if len(cells) == 1 else f"{len(cells)} seeds"
    return Error(1.0 - accuracy, f"trained here, {seeds}")


def _row(
    results: Results, name: str, arithmetic: str, cell: dict[str, Any], frames: int, figures: dict[str, Any]
) -> Row:
    runtime, eager = figures["onnx_runtime"], figures.get("pytorch_eager", {})
    error = None
    if "accuracy" in figures:
        error = Error(1.0 - figures["accuracy"], MEASURED)
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


def _share(row: Row) -> float:
    assert row.error is not None
    return row.error.share
