"""Speed against error, as the page tells it: the picture, one table a length, and what follows from them."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from model import evaluate
from model.classifier import SHIPPED_MODEL
from model.quantize import FLOAT32
from model.ship import SCORES_NAME
from model.study import table2
from model.study.front_rows import PRINTED, Row, front, rows
from model.study.markdown import provenance, table
from model.study.networks import INT8, PAPER_BLOCKS, SHIPPED
from model.study.paper_tables import PAPER_EPOCHS
from model.study.results import Results

ANSWERS = {"1 s": (54,), "1.5 s": (72, 81), "2.67 s": (144,)}
"""Windows of about one time; the paper's "1.5 seconds" are 72 frames."""
FINAL = table2.FRAMES
COST = ("multiply-adds, M", "p50, ms", "p99, ms", "PyTorch p50 / p99, ms")
WEIGHT = ("file, MB", "memory, MB", "error, %", "error from")


def page(results: Results) -> str:
    """Return the section in Markdown; says so where nothing has been measured."""
    found = rows(results)
    if not found:
        return "Not measured yet: `touchd report --only front`.\n"
    lines = [*_introduction(results, found), *_findings(found), ""]
    for name, lengths in ANSWERS.items():
        together = [row for row in found if row.frames in lengths and _in_tables(row)]
        lines += [f"### After {name}", "", *_table(together)]
    lines += ["### Fewer and more blocks of the paper's", "", *_block_table(found)]
    return "\n".join(lines)


def _introduction(results: Results, found: Sequence[Row]) -> Iterator[str]:
    shipped = results.get(f"front/{SHIPPED}/{FLOAT32}")
    yield f"Measured by {provenance(results, 'front/')}."
    yield ""
    yield "![Error against the time of an answer](figures/front.png)"
    yield ""
    yield f"""\
All networks answered in turn in one run on one thread, {shipped["answers_timed"]} times each. p50 and p99 are
in ONNX Runtime, with PyTorch eager beside them for the paper's, whose weights are random here, which does not
change the time. Multiply-adds are those of the products in the graph. Memory is the most that a fresh process
took which does nothing but answer, {shipped["idle_bytes"] / 1e6:.0f} MB of it before any network is opened.
Our int8 is static, the paper's dynamic, and the error of the latter is not measured.

Error is macro error on the test participants. For ours it is over the sensor's own scans and of one seed a
size, all trained by the shipped recipe; the sizes were fixed before they were trained, and nothing was chosen
from these scores. For the paper's it is over windows as published.
"""
    if any(row.error and row.error.source == PRINTED for row in found):
        yield f"""\
Where a network of the paper's has not been trained here for all {PAPER_EPOCHS} epochs, its error is
"{PRINTED}", for which the paper's code chose the epoch on the test participants.
"""


def _findings(found: Sequence[Row]) -> Iterator[str]:
    shipped = _one(found, "touchd", FINAL, SHIPPED)
    for family, title in (("printed", "as printed"), ("public", "as its code has it")):
        theirs = _one(found, family, FINAL)
        eager = f" ({theirs.eager_ms / shipped.p50_ms:.1f} in PyTorch eager)" if theirs.eager_ms else ""
        error = ""
        if theirs.error and shipped.error:
            points = 100 * (theirs.error.share - shipped.error.share)
            error = f", with {abs(points):.1f} points {'less' if points >= 0 else 'more'} error"
        yield (
            f"- Over {FINAL} frames the shipped network answers in {shipped.p50_ms:.2f} ms, "
            f"{theirs.p50_ms / shipped.p50_ms:.1f} times as fast as the paper's {title}{eager}, by "
            f"{theirs.multiply_adds / shipped.multiply_adds:.0f} times fewer multiply-adds{error}."
        )
    for name, lengths in ANSWERS.items():
        best = front([row for row in found if row.frames in lengths])
        members = ", ".join(f"{row.title} in {row.arithmetic}" for row in best)
        yield f"- The front after {name}, fastest first: {members}."
    yield _size_finding(found)
    yield _int8_finding(found)


def _size_finding(found: Sequence[Row]) -> str:
    sizes = [row for row in found if (row.family, row.frames, row.arithmetic) == ("touchd", FINAL, FLOAT32)]
    errors = ", ".join(f"{row.width}: {_error(row)}" for row in sizes)
    seeds = evaluate.read_scores(SHIPPED_MODEL.with_name(SCORES_NAME)).seeds.values()
    spread = np.ptp([100 * seed[str(FINAL)] for seed in seeds])
    return (
        f"- Error in percent over {FINAL} frames by width: {errors}. {len(seeds)} seeds of the shipped size "
        f"lie {spread:.1f} points apart, so that differences of that order between sizes say nothing."
    )


def _int8_finding(found: Sequence[Row]) -> str:
    told = []
    for plain in found:
        if plain.family == "touchd" and plain.arithmetic == FLOAT32 and plain.frames == FINAL:
            small = _one(found, "touchd", FINAL, plain.name, INT8)
            lost = 100 * (_share(small) - _share(plain))
            told.append(f"{plain.width}: {small.p50_ms / plain.p50_ms:.0%} of the time, {lost:+.1f} points")
    for family, title in (("printed", "the paper's as printed"), ("public", "as its code has it")):
        share = _one(found, family, FINAL, None, INT8).p50_ms / _one(found, family, FINAL).p50_ms
        told.append(f"{title}: {share:.0%} of the time")
    return (
        f"- int8 against float32 over {FINAL} frames, by width, with the change in error: {'; '.join(told)}."
    )


def _table(together: Sequence[Row]) -> Iterator[str]:
    best = front(together)
    headings = (
        *(
            "network",
            "arithmetic",
            "frames",
            "multiply-adds, M",
            "p50, ms",
            "p99, ms",
            "PyTorch p50 / p99, ms",
        ),
        *("file, MB", "memory, MB", "error, %", "error from", "on the front"),
    )
    lines = []
    for row in together:
        name = f"**{row.title}**" if row.name == SHIPPED else row.title
        on_it = "yes" if row in best else ""
        lines.append((name, row.arithmetic, str(row.frames), *_cost(row), *_weight(row), on_it))
    yield from table(headings, lines)


def _block_table(found: Sequence[Row]) -> Iterator[str]:
    headings = (
        *(
            "network",
            "multiply-adds, M",
            "p50, ms",
            "p99, ms",
            "PyTorch p50 / p99, ms",
            "file, MB",
            "memory, MB",
        ),
        *("error, %", "error from", "int8 p50, ms"),
    )
    lines = []
    for row in found:
        if row.family != "touchd" and row.frames == FINAL and row.arithmetic == FLOAT32:
            small = _one(found, row.family, FINAL, row.name, INT8)
            lines.append((row.title, *_cost(row), *_weight(row), f"{small.p50_ms:.2f}"))
    yield f"Over {FINAL} frames in float32, with the time in int8 at the end."
    yield ""
    yield from table(headings, lines)


def _cost(row: Row) -> tuple[str, ...]:
    return f"{row.multiply_adds / 1e6:.1f}", f"{row.p50_ms:.2f}", f"{row.p99_ms:.2f}", _eager(row)


def _weight(row: Row) -> tuple[str, ...]:
    source = row.error.source if row.error else ""
    return f"{row.file_bytes / 1e6:.2f}", f"{row.peak_bytes / 1e6:.0f}", _error(row), source


def _in_tables(row: Row) -> bool:
    return row.family == "touchd" or row.blocks == PAPER_BLOCKS


def _one(
    found: Sequence[Row], family: str, frames: int, name: str | None = None, arithmetic: str = FLOAT32
) -> Row:
    """Return the family's row; without a name, the paper's at its own number of blocks."""
    return next(
        row
        for row in found
        if (row.family, row.frames, row.arithmetic) == (family, frames, arithmetic)
        and (row.name == name if name else row.blocks == PAPER_BLOCKS)
    )


def _eager(row: Row) -> str:
    return f"{row.eager_ms:.2f} / {row.eager_p99_ms:.2f}" if row.eager_ms is not None else ""


def _error(row: Row) -> str:
    return f"{100 * row.error.share:.1f}" if row.error else ""


def _share(row: Row) -> float:
    assert row.error is not None
    return row.error.share
