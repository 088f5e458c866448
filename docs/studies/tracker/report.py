"""The tracker's figures: the tables of docs/touch.md, and docs/touch.json, for the test that checks them.

`python -m docs.studies tracker` measures HAART's recordings, in three minutes of one core.
"""

import argparse
from collections.abc import Sequence
from pathlib import Path

import msgspec

from daemon.touch import TouchSettings
from docs.studies.folders import add_docs_argument, add_haart_argument
from docs.studies.marked import fill, table
from docs.studies.tracker.figures import HeldOut, OnsetPoint, TouchReport, measure
from docs.studies.training.haart import read_test, read_training, realigned

POINT_HEADER = (
    "onset level",
    "touches",
    "missed",
    "over 1 s late",
    "delay, median ms",
    "delay, p90 ms",
    "false (per 10 min)",
)
GESTURE_HEADER = (
    "gesture",
    "touches",
    "missed",
    "split",
    "ended early",
    "not released in 3 s",
    "delay, median ms",
    "p90 ms",
    "from the splice, median ms",
    "p90 ms",
    "first frame",
)


def report(haart_folder: Path) -> TouchReport:
    """Measure the default settings on HAART's two files; raises RecordingError without them."""
    training, test = realigned(read_training(haart_folder)), realigned(read_test(haart_folder))
    return measure(training, test, TouchSettings())


def write(figures: TouchReport, folder: Path) -> None:
    """Write touch.json into an existing folder, and fill the tables of touch.md there."""
    (folder / "touch.json").write_bytes(msgspec.json.format(msgspec.json.encode(figures)) + b"\n")
    fill(folder / "touch.md", tables(figures))


def tables(figures: TouchReport) -> dict[str, str]:
    """Return the page's tables by their places."""
    some = next(iter(figures.curve.values()))[0]
    made = {
        "measured": table(
            ("touches", "minutes of notouch", "joins", "felt like a touch"),
            [(some.touches, f"{some.notouch_min:.1f}", figures.joins, figures.touched_joins)],
        ),
        "quiet": _quiet(figures),
    }
    for splice, rows in figures.held_out.items():
        name = splice.replace(" ", "-")
        made[f"left-out-{name}"] = _held_out(rows, figures.unseen[splice])
        made[f"levels-{name}"] = table(POINT_HEADER, [_point_cells(point) for point in figures.curve[splice]])
        made[f"gestures-{name}"] = _gestures(figures, splice)
    return made


def _held_out(rows: Sequence[HeldOut], unseen: OnsetPoint) -> str:
    points = [row.figures for row in rows]
    touches = sum(point.touches for point in points)
    missed = sum(point.missed for point in points)
    late = sum(point.late for point in points)
    false = sum(point.false_touches for point in points)
    false_per_10_min = 10.0 * false / sum(point.notouch_min for point in points)
    total = (
        "**all**",
        "",
        touches,
        _share(missed, touches),
        late,
        "",
        "",
        f"{false} ({false_per_10_min:.1f})",
    )
    body = [(row.participant, *_point_cells(row.figures)) for row in rows]
    return table(("left out", *POINT_HEADER), [*body, total, ("test participants", *_point_cells(unseen))])


def _point_cells(point: OnsetPoint) -> tuple[object, ...]:
    return (
        f"{point.onset_threshold:g}",
        point.touches,
        _share(point.missed, point.touches),
        point.late,
        point.delay_ms_median,
        point.delay_ms_p90,
        f"{point.false_touches} ({point.false_per_10_min:.1f})",
    )


def _gestures(figures: TouchReport, splice: str) -> str:
    rows = [
        (*msgspec.structs.astuple(row)[:-1], f"{row.first_exact:.0%}") for row in figures.by_gesture[splice]
    ]
    return table(GESTURE_HEADER, rows)


def _quiet(figures: TouchReport) -> str:
    gestures = list(figures.quiet[0].split)
    rows = [
        (f"{point.quiet_s:g}", *(point.split[gesture] for gesture in gestures), sum(point.split.values()))
        for point in figures.quiet
    ]
    return table(("quiet time, s", *gestures, "all"), rows)


def _share(part: int, whole: int) -> str:
    return f"{part} ({part / whole:.1%})"


def main(arguments: Sequence[str]) -> int:
    """Measure the recordings in a folder and fill the page; returns 0."""
    parser = argparse.ArgumentParser(prog="python -m docs.studies tracker", description=__doc__)
    add_haart_argument(parser)
    add_docs_argument(parser)
    options = parser.parse_args(arguments)
    write(report(options.haart), options.docs)
    return 0
