"""The adapting study's figures as tables and a picture of docs/adapt.md, summed over participants."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np

from docs.studies.adapting.cells import PULLS, SHOTS, TEST_PARTICIPANTS, Measured, Trial
from docs.studies.marked import table
from model.adapt.measure import Floats, mean_interval
from model.settings import LENGTHS

LAST = str(LENGTHS[-1])


@dataclass(frozen=True)
class Spread:
    """Values of participants, in percent or points: mean, 95 % interval, standard deviation."""

    mean: float
    low: float
    high: float
    sd: float

    @classmethod
    def of(cls, values: Floats) -> Spread:
        """Return the spread of one value a participant."""
        interval = mean_interval([values])
        assert interval is not None
        return cls(float(values.mean()), *interval, float(values.std(ddof=1)))

    @property
    def interval(self) -> str:
        """The interval in words."""
        return f"{self.low:+.1f} to {self.high:+.1f}"


@dataclass(frozen=True)
class Gain:
    """What adapting to `each` recordings a gesture changed at one length.

    own: of the participant's other recordings; others: of other people's. sd_draws: deviation of the gain
    over the draws of one participant.
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


def tables(study: Measured) -> dict[str, str]:
    """Return the page's tables by their places."""
    training = _training(study)
    test = [cell for cell in study.cells if cell.participant in TEST_PARTICIPANTS]
    return {
        "summary": _summary(study),
        "training": _gain_table(gains(training)),
        "test": _gain_table(gains(test)),
        "people": _people(study),
        "verdicts": _verdicts(study.cells),
        "pads": table(
            ("pad", "frames", "before", "after", "difference", "95 % interval"),
            [
                (
                    *("as it is" if pad == "none" else pad, frames),
                    *(f"{before.mean:.1f}", f"{after.mean:.1f}", f"{gain.mean:+.1f}", gain.interval),
                )
                for pad, frames, before, after, gain in pad_rows(study)
            ],
        ),
        "new-gestures": _new_gestures(study),
        "pulls": _pulls(study),
    }


def draw(study: Measured, path: Path) -> None:
    """Draw how accuracy after the last answer moves, that person's and others', with what is adapted to."""
    training = _training(study)
    rows = [row for row in gains(training) if row.frames == LENGTHS[-1]]
    figure, panels = plt.subplots(1, 2, figsize=(9.6, 3.9), layout="constrained", sharey=True)
    places = np.arange(len(SHOTS) + 1)
    for name in dict.fromkeys(cell.participant for cell in training):
        alone = [cell for cell in training if cell.participant == name and not cell.rehearsed]
        own = [np.mean([own_change(cell) for cell in alone if cell.each == each]) for each in SHOTS]
        panels[0].plot(places, [0.0, *own], color="0.75", linewidth=1.0, zorder=1)
        panels[0].annotate(
            name, (places[-1], own[-1]), (4, -3), textcoords="offset points", color="0.5", size=7
        )
    for rehearsed, colour, beside, label in (
        (False, "C0", -0.03, "the folder alone"),
        (True, "C1", 0.03, "HAART rehearsed beside it"),
    ):
        mine = [row for row in rows if row.rehearsed == rehearsed]
        for axes, values in zip(panels, ([r.own for r in mine], [r.others for r in mine]), strict=True):
            means = [0.0, *(value.mean for value in values)]
            reaches = [0.0, *(value.mean - value.low for value in values)]
            axes.errorbar(
                places + beside, means, reaches, color=colour, lw=2, marker="o", ms=5, capsize=3, label=label
            )
    for axes, title in zip(panels, ("that person's other recordings", "other people's"), strict=True):
        axes.axhline(0.0, color="grey", linewidth=0.6)
        axes.set_xticks(places, [str(each) for each in (0, *SHOTS)])
        axes.set(xlabel="recordings a gesture adapted to", title=title, xlim=(-0.2, len(SHOTS) + 0.3))
    panels[0].set_ylabel("change after 2.67 s, points of macro accuracy")
    panels[1].legend(loc="upper left", title="mean over 7 people, 95 % interval")
    figure.savefig(path, dpi=110)
    plt.close(figure)


def gains(cells: Sequence[Trial]) -> list[Gain]:
    """Return what adapting changed, by HAART rehearsed or not, number of recordings, and length."""
    return [
        _gain([cell for cell in cells if (cell.rehearsed, cell.each) == (rehearsed, each)], length)
        for rehearsed in (False, True)
        for each in SHOTS
        for length in LENGTHS
    ]


def pad_rows(study: Measured) -> list[tuple[str, int, Spread, Spread, Spread]]:
    """Return pad, frames, and before, after and difference of participants unseen on it."""
    rows = []
    for pad in dict.fromkeys(entry.pad for entry in study.pads):
        own = [entry for entry in study.pads if entry.pad == pad]
        for frames in LENGTHS:
            before = np.array([100 * entry.before[str(frames)] for entry in own])
            after = np.array([100 * entry.after[str(frames)] for entry in own])
            rows.append((pad, frames, Spread.of(before), Spread.of(after), Spread.of(after - before)))
    return rows


def own_change(cell: Trial, key: str = LAST) -> float:
    """Return the points that a cell's participant won or lost."""
    return 100 * (cell.own_after.accuracy[key] - cell.own_before.accuracy[key])


def _training(study: Measured) -> list[Trial]:
    return [cell for cell in study.cells if cell.participant not in TEST_PARTICIPANTS]


def _gain(cells: Sequence[Trial], frames: int) -> Gain:
    key = str(frames)
    names = list(dict.fromkeys(cell.participant for cell in cells))

    def by_person(value: Callable[[Trial], float]) -> list[list[float]]:
        return [[value(cell) for cell in cells if cell.participant == name] for name in names]

    def spread(value: Callable[[Trial], float]) -> Spread:
        return Spread.of(np.array([np.mean(own) for own in by_person(value)]))

    before = np.mean([cell.own_before.calibration_error for cell in cells])
    after = np.mean([cell.own_after.calibration_error for cell in cells])
    return Gain(
        each=cells[0].each,
        rehearsed=cells[0].rehearsed,
        frames=frames,
        before=spread(lambda cell: 100 * cell.own_before.accuracy[key]),
        after=spread(lambda cell: 100 * cell.own_after.accuracy[key]),
        own=spread(lambda cell: own_change(cell, key)),
        others=spread(lambda c: 100 * (c.others_after.accuracy[key] - c.others_before.accuracy[key])),
        sd_draws=float(np.mean([np.std(own, ddof=1) for own in by_person(lambda c: own_change(c, key))])),
        calibration=f"{before:.3f}, {after:.3f}" if key == LAST else "",
    )


def _summary(study: Measured) -> str:
    last = [row for row in gains(_training(study)) if row.frames == LENGTHS[-1]]
    rows = []
    for who, rehearsed in (("one person", False), ("one person, HAART rehearsed", True)):
        mine = [row for row in last if row.rehearsed == rehearsed]
        rows.append((who, "that person", *(_points(row.own) for row in mine)))
        rows.append((who, "others", *(_points(row.others) for row in mine)))
    pads = {pad: difference for pad, frames, _, _, difference in pad_rows(study) if frames == LENGTHS[-1]}
    empty = [""] * (len(SHOTS) - 1)
    rows.append(("one or two others", "somebody new", *empty, _points(pads["none"])))
    dead = "one or two others, a row of taxels dead"
    rows.append((dead, "somebody new", *empty, _points(pads["one dead row"])))
    return table(("adapted to", "evaluated on", *(f"{each} a gesture" for each in SHOTS)), rows)


def _points(value: Spread) -> str:
    return f"{value.mean:+.1f} ({value.interval})"


def _gain_table(rows: Iterable[Gain]) -> str:
    headings = (
        *("a gesture", "HAART rehearsed", "frames", "before", "after", "difference", "95 % interval"),
        *("sd over draws", "others, difference", "95 % interval", "calibration error before, after"),
    )
    return table(
        headings,
        [
            (
                *(row.each, _yes(row.rehearsed), row.frames),
                *(
                    f"{row.before.mean:.1f} ± {row.before.sd:.1f}",
                    f"{row.after.mean:.1f} ± {row.after.sd:.1f}",
                ),
                *(f"**{row.own.mean:+.1f}**", row.own.interval, f"{row.sd_draws:.1f}"),
                *(f"{row.others.mean:+.1f}", row.others.interval, row.calibration),
            )
            for row in rows
        ],
    )


def _people(study: Measured) -> str:
    names = list(dict.fromkeys(cell.participant for cell in study.cells))

    def means(chosen: Callable[[Trial], bool], value: Callable[[Trial], float]) -> list[str]:
        return [
            f"{100 * np.mean([value(c) for c in study.cells if c.participant == name and chosen(c)]):.1f}"
            for name in names
        ]

    rows = [("", 0, *means(lambda cell: True, lambda cell: cell.own_before.accuracy[LAST]))]
    for rehearsed in (False, True):
        for each in SHOTS:
            key = (rehearsed, each)
            after = means(
                lambda cell, key=key: (cell.rehearsed, cell.each) == key,  # type: ignore[misc]
                lambda cell: cell.own_after.accuracy[LAST],
            )
            rows.append((_yes(rehearsed), each, *after))
    return table(("HAART rehearsed", "a gesture", *names), rows)


def _verdicts(cells: Sequence[Trial]) -> str:
    """Return how often the command would have reported what, and how often that held on unseen recordings."""
    rows = []
    for each in SHOTS[1:]:
        own = [cell for cell in cells if cell.each == each and not cell.rehearsed]
        for verdict in ("better", "cannot tell", "worse"):
            changes = [own_change(cell) for cell in own if _verdict(cell) == verdict]
            if changes:
                better = sum(change > 0 for change in changes)
                counts = (f"{len(changes)} of {len(own)}", f"{better} of {len(changes)}")
                rows.append((each, verdict, *counts, f"{np.mean(changes):+.1f}"))
    return table(("a gesture", "it reported", "how often", "truly better", "mean difference there"), rows)


def _verdict(cell: Trial) -> str:
    if cell.told is None or cell.told[1] <= 0.0 <= cell.told[2]:
        return "cannot tell"
    return "better" if cell.told[1] > 0.0 else "worse"


def _new_gestures(study: Measured) -> str:
    rows = []
    for each in SHOTS:
        own = [entry for entry in study.new_gestures if entry.each == each]
        names = ("right", "others_before", "others_after")
        rows.append((each, *(f"{100 * np.mean([getattr(e, name) for e in own]):.1f}" for name in names)))
    return table(("a gesture", "new gesture right, %", "the others before, %", "after, %"), rows)


def _pulls(study: Measured) -> str:
    rows = []
    for pull in PULLS:
        for each in SHOTS:
            own = [entry for entry in study.pulls if (entry.pull, entry.each) == (pull, each)]
            mark = "**" if pull == study.settings.l2_sp else ""
            means = (f"{100 * np.mean([getattr(e, name) for e in own]):+.1f}" for name in ("own", "others"))
            rows.append((f"{mark}{pull:g}{mark}", each, *means))
    return table(("l2_sp", "a gesture", "that person", "others"), rows)


def _yes(rehearsed: bool) -> str:
    return "yes" if rehearsed else "no"
