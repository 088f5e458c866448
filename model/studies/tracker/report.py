"""How well touches are detected: the tables of docs/sessions.md, and `stored/touch.json` with all figures.

`python -m touchd.model.studies tracker` measures HAART's recordings, in three minutes of one core.
"""

from collections.abc import Iterator, Sequence

import msgspec

from touchd.daemon.path.tracker.tracker import TouchSettings
from touchd.model.studies.folders import study_parser
from touchd.model.studies.marked import fill, table
from touchd.model.studies.results import STORED
from touchd.model.studies.tracker.figures import OnsetPoint, TouchReport, measure
from touchd.model.training.haart import read_test, read_training, realigned

FILE = STORED / "touch.json"
LEVELLED = "rest levelled"
SHOWN = (1.0, 2.0, 4.0, 8.0, 16.0)
"""The thresholds of the page's table: the default, and others by factors of two."""
COSTS = ("touches", "missed", "over 1 s late", "delay, median / p90 ms", "false (per 10 min)")


def tables(figures: TouchReport) -> dict[str, str]:
    """Return the page's tables by their places."""
    noisy = {point.onset_threshold: point.false_per_10_min for point in figures.noisy}
    return {
        "detected": table(("people", "rest", *COSTS), _detected(figures)),
        "levels": table(
            ("onset threshold", *COSTS[1:], "on a noisier pad"),
            [
                (f"{point.onset_threshold:g}", *_costs(point)[1:], noisy[point.onset_threshold])
                for point in figures.curve[LEVELLED]
                if point.onset_threshold in SHOWN
            ],
        ),
        "quiet": table(
            ("quiet time, s", "strokes", "all gestures"),
            [(f"{one.quiet_s:g}", one.split["stroke"], sum(one.split.values())) for one in figures.quiet],
        ),
    }


def _detected(figures: TouchReport) -> Iterator[tuple[object, ...]]:
    """Yield the test participants at the default, and training participants held out, under each splice."""
    for splice, point in figures.unseen.items():
        yield ("HAART test", splice.removeprefix("rest "), *_costs(point))
    for splice, rows in figures.held_out.items():
        points = [row.figures for row in rows]
        touches, missed, late, false = (
            sum(getattr(point, name) for point in points)
            for name in ("touches", "missed", "late", "false_touches")
        )
        per_10_min = 10.0 * false / sum(point.notouch_min for point in points)
        falsely = f"{false} ({per_10_min:.1f})"
        yield ("HAART held out", splice.removeprefix("rest "), touches, missed, late, "", falsely)


def _costs(point: OnsetPoint) -> tuple[object, ...]:
    return (
        point.touches,
        point.missed,
        point.late,
        f"{point.delay_ms_median:g} / {point.delay_ms_p90:g}",
        f"{point.false_touches} ({point.false_per_10_min:.1f})",
    )


def main(arguments: Sequence[str]) -> int:
    """Measure the recordings in a folder and fill the page; returns 0."""
    options = study_parser("tracker", __doc__, "haart", "docs").parse_args(arguments)
    training, test = (realigned(read(options.haart)) for read in (read_training, read_test))
    figures = measure(training, test, TouchSettings())
    FILE.write_bytes(msgspec.json.format(msgspec.json.encode(figures)) + b"\n")
    fill(options.docs / "sessions.md", tables(figures))
    return 0
