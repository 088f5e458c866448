"""The tracker's figures as docs/touch.md, for people, and docs/touch.json, for the test that holds them.

`python -m docs.studies tracker FOLDER [DOCS]` measures HAART's recordings, in three minutes of one core.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path

import msgspec

from daemon.touch import TouchSettings
from docs.studies.tracker.figures import FRAME_MS, HeldOut, OnsetPoint, TouchReport, measure
from model.training.haart import read_test, read_training, realigned

INTRODUCTION = """# When a touch begins and ends

What the tracker in `daemon/touch.py` does on recordings that it was not tuned on, and what other
settings would cost. Rebuild with `python -m docs.studies tracker FOLDER`, FOLDER being HAART's.

**What was measured.** Each touching recording of HAART's training participants ({touches}), realigned to
whole scans, between notouch of the same participant, substrate and cover: five seconds before,
three after. False touches are counted in the {minutes:.1f} minutes of notouch recordings alone, each
from its start-up on.

**What the delays mean.** The recordings begin in the middle of a gesture; pat, stroke and tickle may
begin within a lift-off. So the delay counts from the first scan with visible pressure (more than any
scan of notouch has), and the delay from the splice is given beside it. One frame is {frame_ms:.1f} ms.

**Two ways to splice.** Rest differs between recordings by a few counts, and this jump alone can be
noticed. "As recorded" leaves it in; "rest levelled" brings the notouch to the rest of the gesture's own
recording (except for `constant`, which never leaves the pad), and is the harder and fairer of the two.
"""

CHOICE = """## What was tried

Measured once, while the statistic was chosen: a mean of three scans above a rest learned before, the
threshold 15 % above the worst of all notouch, rest levelled. Of 495 touches, those noticed later than a
second after the splice: largest rise of a taxel 16, strongest three together 19, root of summed squares 12,
sum of rises 14, sum of rises beyond one row or column **5**. The worst of notouch is one recording in which
a row steps up and down by 2 to 6 counts; discounting one wire takes it from twice a light touch to nothing.
Scaling each taxel by its own noise and subtracting what a row or the pad has in common lost light touches,
which lift whole rows themselves.
"""

LEFT_OUT = """## Participants left out

The onset level chosen on six participants, tried on the seventh. The rule: the middle (by ratio) of the
levels that meet the targets (misses 2 %, one false touch in ten minutes, 100 ms) twice over. The
tracker's other numbers (noise floor, wire discount, quiet time) were set on all seven; so the last row is
the fairest, HAART's test participants at the default, on whom nothing was tuned.
"""

LEVELS = """## What other onset levels would cost

The default is {level:g}; counts summed over the pad, above rest and noise. A touch is also missed when a
false one was on already.
"""

GESTURES = """## Each gesture at the default

Split: felt as several touches. Ended early: half a second or more of visible pressure was in no touch.
First frame: share of touches dated to within one frame of the first visible pressure.
"""

QUIET = """## How long a quiet ends a touch

Recordings felt as several touches, as recorded. The default is {quiet_s:g} s: two touches closer than
that are one.
"""

JOINS = """## When the pad's rest jumps

Notouch recordings of one participant end to end, where substrate or cover changes at each join:
{touched} of {joins} joins felt like a touch. A pad in use does not change so; what keeps still becomes
rest after {settled_s:g} s.
"""

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
    """Write touch.md and touch.json into an existing folder, over older ones."""
    (folder / "touch.json").write_bytes(msgspec.json.format(msgspec.json.encode(figures)) + b"\n")
    (folder / "touch.md").write_text(markdown(figures), encoding="utf-8")


def markdown(figures: TouchReport) -> str:
    """Return the figures as a page."""
    some = next(iter(figures.curve.values()))[0]
    settings = figures.settings
    parts = [
        INTRODUCTION.format(touches=some.touches, minutes=some.notouch_min, frame_ms=FRAME_MS),
        CHOICE,
        LEFT_OUT,
    ]
    for splice, rows in figures.held_out.items():
        parts += [_heading(splice), _held_out(rows, figures.unseen[splice])]
    parts.append(LEVELS.format(level=settings.onset_threshold))
    for splice, points in figures.curve.items():
        parts += [_heading(splice), _table(POINT_HEADER, [_point_cells(point) for point in points])]
    parts.append(GESTURES)
    for splice in figures.by_gesture:
        parts += [_heading(splice), _gestures(figures, splice)]
    parts += [QUIET.format(quiet_s=settings.quiet_s), _quiet(figures)]
    parts.append(
        JOINS.format(touched=figures.touched_joins, joins=figures.joins, settled_s=settings.settled_s)
    )
    return "\n".join(parts)


def _heading(splice: str) -> str:
    return f"### {splice.capitalize()}\n"


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
    return _table(("left out", *POINT_HEADER), [*body, total, ("test participants", *_point_cells(unseen))])


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
    return _table(GESTURE_HEADER, rows)


def _quiet(figures: TouchReport) -> str:
    gestures = list(figures.quiet[0].split)
    rows = [
        (f"{point.quiet_s:g}", *(point.split[gesture] for gesture in gestures), sum(point.split.values()))
        for point in figures.quiet
    ]
    return _table(("quiet time, s", *gestures, "all"), rows)


def _share(part: int, whole: int) -> str:
    return f"{part} ({part / whole:.1%})"


def _table(header: Sequence[str], rows: Iterable[Sequence[object]]) -> str:
    lines = [header, ["---"] * len(header), *rows]
    return "\n".join("| " + " | ".join(str(cell) for cell in line) + " |" for line in lines) + "\n"


def main(arguments: Sequence[str]) -> int:
    """Measure the recordings in a folder and write the page; returns 0."""
    folder, docs = (*arguments, "docs")[:2]
    write(report(Path(folder)), Path(docs))
    return 0
