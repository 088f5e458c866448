"""What int8 costs the paper's network in accuracy: the kept one, over all test windows."""

from __future__ import annotations

import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from docs.studies import quantize
from docs.studies.report import paper_kept, paper_training
from docs.studies.report.networks import export
from docs.studies.report.paper_cells import PaperCell
from docs.studies.report.paper_tables import PAPER_EPOCHS, describe
from docs.studies.report.peak import open_session
from docs.studies.report.results import Results
from docs.studies.report.study import Study
from model.training import haart

PREFIX = "int8/"


def key(cell: PaperCell) -> str:
    """Return where the cell's int8 accuracy stands among the results."""
    return f"{PREFIX}{cell.training}/epochs{cell.epochs}"


def run(study: Study) -> None:
    """Ask the kept network in int8, unless that has been done."""
    cell = paper_kept.kept_cell(study.results)
    if cell is None or study.results.has(key(cell)):
        return
    began_s = time.perf_counter()
    test = haart.cut(haart.read_test(study.haart), cell.frames)
    with tempfile.TemporaryDirectory() as folder:
        plain = Path(folder) / f"{cell.training}.onnx"
        export(paper_kept.load_kept(study.docs, cell), cell.frames, plain)
        small = quantize.convert(plain, "int8 dynamic", (), Path(folder))
        accuracies = {
            name: round(paper_training.macro_accuracy(answers(path, test.counts), test.labels), 5)
            for name, path in (("float32", plain), ("int8", small))
        }
    study.results.put(key(cell), accuracies, time.perf_counter() - began_s)


def answers(path: Path, counts: NDArray[np.uint16]) -> NDArray[np.float64]:
    """Return what a file answers, logits (N, 7), to windows of counts (N, L, 8, 8) one by one."""
    session = open_session(path)
    return np.concatenate(
        [session.run(None, {"counts": window[np.newaxis].astype(np.float32)})[0] for window in counts]
    ).astype(np.float64)


def finding(results: Results) -> Iterator[str]:
    """Yield what it costs, as an item of a list; nothing where it is not measured."""
    cell = paper_kept.kept_cell(results)
    if cell is None or not results.has(key(cell)):
        return
    accuracies = results.get(key(cell))
    error, points = 1 - accuracies["float32"], accuracies["float32"] - accuracies["int8"]
    yield (
        f"- int8 changes the {100 * error:.1f} % error of the paper's network, "
        f"{describe(cell.variant, cell.blocks)}, {cell.frames} frames, after {cell.epochs} of {PAPER_EPOCHS} "
        f"epochs here, by {100 * points:+.1f} points."
    )
