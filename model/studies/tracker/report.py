"""The tracker's figures: the tables of docs/touch.md, and docs/touch.json, for the test that checks them.

`python -m touchd.model.studies tracker` measures HAART's recordings, in three minutes of one core.
"""

from collections.abc import Sequence

import msgspec

from touchd.daemon.tracker.tracker import TouchSettings
from touchd.model.studies.folders import study_parser
from touchd.model.studies.marked import fill, table
from touchd.model.studies.tracker.figures import HeldOut, OnsetPoint, TouchReport, measure
from touchd.model.training.haart import read_test, read_training, realigned

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


def tables(figures: TouchReport) -> dict[str, str]:
    """Return the page's tables by their places."""
    some = next(iter(figures.curve.values()))[0]
    made = {
        "measured": table(
            ("touches", "minutes of notouch", "joins", "felt like a touch"),
            [(some.touches, f"{some.notouch_min:.1f}", figures.joins, figures.touched_joins)],
        ),
        "quiet": table(
            ("quiet time, s", *figures.quiet[0].split, "all"),
            [(f"{one.quiet_s:g}", *one.split.values(), sum(one.split.values())) for one in figures.quiet],
        ),
    }
    for splice, rows in figures.held_out.items():
        name = splice.replace(" ", "-")
        made[f"left-out-{name}"] = _held_out(rows, figures.unseen[splice])
        made[f"levels-{name}"] = table(POINT_HEADER, [_point_cells(point) for point in figures.curve[splice]])
        gestures = [
            (*msgspec.structs.astuple(row)[:-1], f"{row.first_exact:.0%}")
            for row in figures.by_gesture[splice]
        ]
        made[f"gestures-{name}"] = table(GESTURE_HEADER, gestures)
    return made


def _held_out(rows: Sequence[HeldOut], unseen: OnsetPoint) -> str:
    points = [row.figures for row in rows]
    touches, missed, late, false = (
        sum(getattr(point, name) for point in points)
        for name in ("touches", "missed", "late", "false_touches")
    )
    false_per_10_min = 10.0 * false / sum(point.notouch_min for point in points)
    falsely = f"{false} ({false_per_10_min:.1f})"
    total = ("**all**", "", touches, _share(missed, touches), late, "", "", falsely)
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


def _share(part: int, whole: int) -> str:
    return f"{part} ({part / whole:.1%})"


def main(arguments: Sequence[str]) -> int:
    """Measure the recordings in a folder and fill the page; returns 0."""
    options = study_parser("tracker", __doc__, "haart", "docs").parse_args(arguments)
    training, test = (realigned(read(options.haart)) for read in (read_training, read_test))
    figures = measure(training, test, TouchSettings())
    (options.docs / "touch.json").write_bytes(msgspec.json.format(msgspec.json.encode(figures)) + b"\n")
    fill(options.docs / "touch.md", tables(figures))
    return 0
