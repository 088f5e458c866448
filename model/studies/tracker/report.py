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
SHOWN = (2.0, 4.0, 8.0)
"""The thresholds of the page's table: the default, half and twice it."""
SHOWN_QUIET_S = (0.5, 0.8, 1.0)
COSTS = ("missed", "over 1 s late", "delay, median / p90 ms", "false")


def tables(figures: TouchReport) -> dict[str, str]:
    """Return the page's tables by their places."""
    noisy = {point.onset_threshold: point.false_per_10_min for point in figures.noisy}
    return {
        "detected": table(("people", "touches", *COSTS), _detected(figures)),
        "levels": table(
            ("onset threshold", *COSTS, "false on a noisier pad"),
            [
                (f"{point.onset_threshold:g}", *_costs(point), noisy[point.onset_threshold])
                for point in figures.curve[LEVELLED]
                if point.onset_threshold in SHOWN
            ],
        ),
        "quiet": table(
            ("quiet time, s", "strokes", "all gestures"),
            [
                (f"{one.quiet_s:g}", one.split["stroke"], sum(one.split.values()))
                for one in figures.quiet
                if one.quiet_s in SHOWN_QUIET_S
            ],
        ),
    }


def _detected(figures: TouchReport) -> Iterator[tuple[object, ...]]:
    """Yield the test participants at the default, and training participants held out."""
    test = figures.unseen[LEVELLED]
    yield ("HAART test", test.touches, *_costs(test))
    points = [row.figures for row in figures.held_out[LEVELLED]]
    touches, missed, late, false = (
        sum(getattr(point, name) for point in points)
        for name in ("touches", "missed", "late", "false_touches")
    )
    yield ("HAART held out", touches, missed, late, "", false)


def _costs(point: OnsetPoint) -> tuple[object, ...]:
    delay = f"{point.delay_ms_median:g} / {point.delay_ms_p90:g}"
    return (point.missed, point.late, delay, point.false_touches)


def main(arguments: Sequence[str]) -> int:
    """Measure the recordings in a folder and fill the page; returns 0."""
    options = study_parser("tracker", __doc__, "haart", "docs").parse_args(arguments)
    training, test = (realigned(read(options.haart)) for read in (read_training, read_test))
    figures = measure(training, test, TouchSettings())
    FILE.write_bytes(msgspec.json.format(msgspec.json.encode(figures)) + b"\n")
    fill(options.docs / "sessions.md", tables(figures))
    return 0
