"""The figures of the adapting study, summed up over participants."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from docs.studies.adapting.cells import KS, PULLS, Cell, NewGesture, OtherPad, Pull
from model.adapt.measure import Floats, mean_interval
from model.settings import LENGTHS


@dataclass(frozen=True)
class Spread:
    """Values of participants, in percent or points: their mean, its 95 % interval, their deviation."""

    mean: float
    low: float
    high: float
    sd: float


@dataclass(frozen=True)
class Gain:
    """What adapting to `each` recordings a gesture changed at one length.

    own: of the participant's other recordings; others: of other people's. sd_draws: deviation of the gain
    over the draws of one participant. calibration: error before and after, at the longest answer only.
    """

    each: int
    rehearsed: bool
    frames: int
    before: Spread
    after: Spread
    own: Spread
    others: Spread
    sd_draws: float
    calibration: str


@dataclass(frozen=True)
class Verdict:
    """How often the command would have said something, and how that was on recordings it never had."""

    each: int
    said: str
    times: int
    out_of: int
    truly_better: int
    mean_difference: float


@dataclass(frozen=True)
class NewGestureRow:
    """The mean over gestures and participants, in percent."""

    each: int
    right: float
    others_before: float
    others_after: float


@dataclass(frozen=True)
class PadRow:
    """Unseen participants on one pad at one length, before and after adapting to others on it."""

    pad: str
    frames: int
    before: Spread
    after: Spread
    difference: Spread


def gains(cells: Sequence[Cell]) -> list[Gain]:
    """Return what adapting changed, by HAART rehearsed or not, number of recordings, and length."""
    return [
        _gain([cell for cell in cells if (cell.rehearsed, cell.each) == (rehearsed, each)], length)
        for rehearsed in (False, True)
        for each in KS
        for length in LENGTHS
    ]


def verdicts(cells: Sequence[Cell]) -> list[Verdict]:
    """Return what the command would have said, without HAART, and how often that held."""
    rows = []
    for each in KS[1:]:
        own = [cell for cell in cells if cell.each == each and not cell.rehearsed]
        for said in ("better", "cannot tell", "worse"):
            these = [
                change(cell.own_before.accuracy, cell.own_after.accuracy)
                for cell in own
                if _said(cell) == said
            ]
            mean = float(np.mean(these)) if these else 0.0
            rows.append(Verdict(each, said, len(these), len(own), sum(value > 0 for value in these), mean))
    return [row for row in rows if row.times]


def new_gesture_rows(entries: Sequence[NewGesture]) -> list[NewGestureRow]:
    """Return how new gestures fare, a row for each number of recordings."""
    rows = []
    for each in KS:
        own = [entry for entry in entries if entry.each == each]
        means = [
            100 * float(np.mean([getattr(entry, name) for entry in own]))
            for name in ("right", "others_before", "others_after")
        ]
        rows.append(NewGestureRow(each, *means))
    return rows


def pad_rows(entries: Sequence[OtherPad]) -> list[PadRow]:
    """Return how people unseen are answered on each pad, a row for each pad and length."""
    rows = []
    for pad in dict.fromkeys(entry.pad for entry in entries):
        own = [entry for entry in entries if entry.pad == pad]
        for frames in LENGTHS:
            key = str(frames)
            befores = np.array([100 * entry.before[key] for entry in own])
            afters = np.array([100 * entry.after[key] for entry in own])
            rows.append(PadRow(pad, frames, _spread(befores), _spread(afters), _spread(afters - befores)))
    return rows


def change(before: dict[str, float], after: dict[str, float], frames: int = LENGTHS[-1]) -> float:
    """Return a difference in points."""
    return 100 * (after[str(frames)] - before[str(frames)])


def pull_rows(entries: Sequence[Pull]) -> list[Pull]:
    """Return the mean over participants for each pull and number of recordings."""
    rows = []
    for pull in PULLS:
        for each in KS:
            own = [entry for entry in entries if (entry.pull, entry.each) == (pull, each)]
            mine, others = (float(np.mean([getattr(e, name) for e in own])) for name in ("own", "others"))
            rows.append(Pull(participant="", pull=pull, each=each, own=100 * mine, others=100 * others))
    return rows


def own_change(cell: Cell) -> float:
    """Return the points that a cell's participant won or lost after the last answer."""
    return change(cell.own_before.accuracy, cell.own_after.accuracy)


def _gain(cells: Sequence[Cell], frames: int) -> Gain:
    names = list(dict.fromkeys(cell.participant for cell in cells))
    key = str(frames)

    def each_person(values: Sequence[float]) -> Floats:
        return np.array(
            [
                np.mean(
                    [value for value, cell in zip(values, cells, strict=True) if cell.participant == name]
                )
                for name in names
            ]
        )

    own = [change(cell.own_before.accuracy, cell.own_after.accuracy, frames) for cell in cells]
    others = [change(cell.others_before.accuracy, cell.others_after.accuracy, frames) for cell in cells]
    draws = [
        np.std([value for value, cell in zip(own, cells, strict=True) if cell.participant == name], ddof=1)
        for name in names
    ]
    errors = [
        float(np.mean([cell.own_before.calibration_error for cell in cells])),
        float(np.mean([cell.own_after.calibration_error for cell in cells])),
    ]
    return Gain(
        each=cells[0].each,
        rehearsed=cells[0].rehearsed,
        frames=frames,
        before=_spread(each_person([100 * cell.own_before.accuracy[key] for cell in cells])),
        after=_spread(each_person([100 * cell.own_after.accuracy[key] for cell in cells])),
        own=_spread(each_person(own)),
        others=_spread(each_person(others)),
        sd_draws=float(np.mean(draws)),
        calibration=f"{errors[0]:.3f}, {errors[1]:.3f}" if frames == LENGTHS[-1] else "",
    )


def _spread(values: Floats) -> Spread:
    interval = mean_interval([values])
    assert interval is not None
    return Spread(float(values.mean()), *interval, float(values.std(ddof=1)))


def _said(cell: Cell) -> str:
    if cell.told is None or cell.told[1] <= 0.0 <= cell.told[2]:
        return "cannot tell"
    return "better" if cell.told[1] > 0.0 else "worse"
