"""Speed against error, as the page tells it: the picture, one table a length, and what follows from them."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from docs.studies.quantize import FLOAT32
from docs.studies.report import kept_int8, table2
from docs.studies.report.front_rows import PRINTED, Row, front, rows
from docs.studies.report.markdown import provenance, table
from docs.studies.report.networks import INT8, OURS, PAPER_BLOCKS, SHIPPED
from docs.studies.report.paper_tables import PAPER_EPOCHS
from docs.studies.report.results import Results
from model.checks import evaluate
from model.training.ship import HAART_MODEL, SCORES_NAME

ANSWERS = {"1 s": (54,), "1.5 s": (72, 81), "2.67 s": (144,)}
"""Windows of about one time; the paper's "1.5 seconds" are 72 frames."""
FINAL = table2.FRAMES
TITLES = {"printed": "as printed", "public": "as its code has it"}
COST = ("multiply-adds, M", "p50, ms", "p99, ms", "processor, ms", "PyTorch p50 / p99, ms")
WEIGHT = ("file, MB", "memory, MB", "error, %", "error from")


def page(results: Results) -> str:
    """Return the section in Markdown; says so where nothing has been measured."""
    found = rows(results)
    if not found:
        return "Not measured yet: `python -m docs.studies report --only front`.\n"
    lines = [*_introduction(results, found), *_findings(found), *kept_int8.finding(results), ""]
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
All networks answered in turn in one run on one thread, {shipped["answers_timed"]} times each. p50, p99 and
the median processor time, by which networks are compared here, are in ONNX Runtime, with PyTorch eager beside
for the others, whose weights are random here, which does not change the time. Multiply-adds are those of the
products in the graph. Memory is the most that a fresh process took which does nothing but answer, the median
of three; {shipped["idle_bytes"] / 1e6:.0f} MB of it are there before any network is opened.
Our int8 is static, the others' dynamic; of the error of the latter one sample was measured, told below.

Error is macro error on the test participants. For ours it is over the sensor's own scans and of one seed a
size, all trained by the shipped recipe; the sizes were fixed before they were trained, and nothing was chosen
from these scores. For the others it is over windows as published.
"""
    if any(row.error and row.error.source == PRINTED for row in found):
        yield f"""\
Where a network of the paper's has not been trained here for all {PAPER_EPOCHS} epochs, its error is
"{PRINTED}", for which the paper's code chose the epoch on the test participants.
"""


def _findings(found: Sequence[Row]) -> Iterator[str]:
    shipped = _one(found, OURS, FINAL, SHIPPED)
    for family, title in TITLES.items():
        theirs = _one(found, family, FINAL)
        runtime = theirs.processor_ms / shipped.processor_ms
        eager = (theirs.eager_processor_ms or 0.0) / shipped.processor_ms
        work = theirs.multiply_adds / shipped.multiply_adds
        points = 100 * (_share(theirs) - _share(shipped))
        yield (
            f"- Over {FINAL} frames the paper's network {title} takes {runtime:.1f} times as long as the "
            f"shipped one, {eager:.1f} times in PyTorch eager, for {work:.0f} times the multiply-adds, with "
            f"{points:+.1f} points of error ({_source(theirs)})."
        )
    for name, lengths in ANSWERS.items():
        best = front([row for row in found if row.frames in lengths])
        members = "; ".join(f"{row.title} in {row.arithmetic}" for row in best)
        yield f"- The front after {name}, fastest first: {members}."
    yield _size_finding(found)
    yield _int8_finding(found)


def _size_finding(found: Sequence[Row]) -> str:
    sizes = [row for row in found if (row.family, row.frames, row.arithmetic) == (OURS, FINAL, FLOAT32)]
    errors = ", ".join(f"{row.width}: {_error(row)}" for row in sizes)
    seeds = evaluate.read_scores(HAART_MODEL.with_name(SCORES_NAME)).seeds.values()
    spread = np.ptp([100 * seed[str(FINAL)] for seed in seeds])
    return (
        f"- Error in percent over {FINAL} frames by width: {errors}. {len(seeds)} seeds of the shipped size "
        f"lie {spread:.1f} points apart, so that differences of that order between sizes say nothing."
    )


def _int8_finding(found: Sequence[Row]) -> str:
    told = []
    for plain in found:
        if plain.family == OURS and plain.arithmetic == FLOAT32 and plain.frames == FINAL:
            small = _one(found, OURS, FINAL, plain.name, INT8)
            points = 100 * (_share(small) - _share(plain))
            told.append(f"{plain.width}: {_of_the_time(small, plain)}, {points:+.1f} points")
    for family, title in TITLES.items():
        small, plain = _one(found, family, FINAL, None, INT8), _one(found, family, FINAL)
        told.append(f"the paper's {title}: {_of_the_time(small, plain)}")
    return (
        f"- int8 against float32 over {FINAL} frames, by width, with the change in error: {'; '.join(told)}."
    )


def _of_the_time(small: Row, plain: Row) -> str:
    return f"{small.processor_ms / plain.processor_ms:.0%} of the time"


def _table(together: Sequence[Row]) -> Iterator[str]:
    best = front(together)
    headings = ("network", "arithmetic", "frames", *COST, *WEIGHT, "on the front")
    lines = []
    for row in together:
        name = f"**{row.title}**" if row.shipped else row.title
        on_it = "yes" if row in best else ""
        lines.append((name, row.arithmetic, str(row.frames), *_cost(row), *_weight(row), on_it))
    yield from table(headings, lines)


def _block_table(found: Sequence[Row]) -> Iterator[str]:
    headings = ("network", *COST, *WEIGHT, "int8 processor, ms")
    lines = []
    for row in found:
        if row.family in TITLES and row.frames == FINAL and row.arithmetic == FLOAT32:
            small = _one(found, row.family, FINAL, row.name, INT8)
            lines.append((row.title, *_cost(row), *_weight(row), f"{small.processor_ms:.2f}"))
    yield (
        f"Over {FINAL} frames in float32, with the time in int8 at the end. Printed errors are those of "
        f"table 2, for {PAPER_BLOCKS} blocks of table 3, as table 2 prints {table2.PAPER[PAPER_BLOCKS]} % "
        "accuracy there."
    )
    yield ""
    yield from table(headings, lines)


def _cost(row: Row) -> tuple[str, ...]:
    times = (f"{ms:.2f}" for ms in (row.p50_ms, row.p99_ms, row.processor_ms))
    return f"{row.multiply_adds / 1e6:.1f}", *times, _eager(row)


def _weight(row: Row) -> tuple[str, ...]:
    return f"{row.file_bytes / 1e6:.2f}", f"{row.peak_bytes / 1e6:.0f}", _error(row), _source(row)


def _in_tables(row: Row) -> bool:
    return row.family not in TITLES or row.blocks == PAPER_BLOCKS


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
    return f"{row.eager_p50_ms:.2f} / {row.eager_p99_ms:.2f}" if row.eager_p50_ms is not None else ""


def _error(row: Row) -> str:
    return f"{100 * row.error.share:.1f}" if row.error else ""


def _source(row: Row) -> str:
    return row.error.source if row.error else ""


def _share(row: Row) -> float:
    assert row.error is not None
    return row.error.share
