"""Touches that are none of the gestures: `python -m touchd.model.studies others`.

The recorded ones are the third study's eight other gestures, by people whom the network never saw; each of
the eight is also held out once. Blows and squeezes are simulated, differently from those of the training, on
the rest of HAART's test people. Caresses are those of the page's hand. All except windows are played through
the daemon's pipeline. `--firm-pad` adds a pad on which nothing was trained.
"""

import logging
import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
from numpy.random import Generator, RandomState
from numpy.typing import NDArray

from touchd.daemon.path.events import UNCERTAIN, Event, Prediction
from touchd.drivers.fakes.hand import Fabric
from touchd.drivers.fakes.pointers import Pointer, PressingHands
from touchd.drivers.frame import COLUMNS, FRAME_RATE_HZ, MAX_COUNT, NO_TOUCH, OTHER, ROWS, Counts
from touchd.drivers.pad.format import Layout, PadFormat
from touchd.drivers.recording import Recording, on_grid
from touchd.model.classifier import Classifier
from touchd.model.studies.checks.evaluate import Split, answer
from touchd.model.studies.folders import STUDIES, TEST, THIRD, folders_of, never_seen, study_parser
from touchd.model.studies.marked import fill, table
from touchd.model.studies.play import frames_of, play
from touchd.model.studies.results import STORED, keep
from touchd.model.studies.sessions import firm_pad, streams
from touchd.model.training import third_study
from touchd.model.training.studies import Folders
from touchd.model.training.weights import left_out_split

FILE = STORED / "others.json"
LENGTHS = (54, 144)
SURE, VERY_SURE = 0.6, 0.65
LIMITS = (0.1, 0.2, 0.3, 0.5)
MADE = 72
SPEEDS_S = (1.0, 1.5, 2.0, 3.0, 5.0)
CARESSES = 24
REST_FRAMES, AFTER_FRAMES = 108, 162
FIRM_HZ = 8.0
FIRM = ("grab", "hug", "punch", "squeez")
ROW, COLUMN = np.mgrid[0:ROWS, 0:COLUMNS].astype(np.float64)
Floats = NDArray[np.float64]


class Told(msgspec.Struct, frozen=True, kw_only=True):
    """Percent of n touches for which the robot was told an answer, by its kind and least confidence."""

    n: int
    known: float
    known_very_sure: float
    known_sure: float
    other: float
    right: float = 0.0


class Windows(msgspec.Struct, frozen=True, kw_only=True):
    """Answers about windows of one length of touches that are none of the gestures, in percent.

    named: one of the gestures with at least 0.6. other: answered as such. auroc: how well the probability of
    `other` tells them from the same people's gestures. by_gesture: named, of each.
    """

    frames: int
    n: int
    named: float
    other: float
    auroc: float
    by_gesture: dict[str, float]


class Lost(msgspec.Struct, frozen=True, kw_only=True):
    """Percent of windows of the gestures themselves that are answered `other`, by length."""

    people: str
    after: dict[str, float]
    by_gesture: dict[str, float]


class Trade(msgspec.Struct, frozen=True, kw_only=True):
    """With one limit on the probability of `other`: percent of the eight others named, of the six lost."""

    limit: float
    named: float
    lost: float


class Measured(msgspec.Struct, frozen=True, kw_only=True):
    """The figures, as they are stored."""

    model: str
    windows: list[Windows]
    lost: list[Lost]
    trade: list[Trade]
    streams: Told
    made: dict[str, Told]
    blows_called_pat: float
    caresses: dict[str, Told]
    firm_pad: Told | None


@dataclass(frozen=True, eq=False)
class Asked:
    """Windows of one length with their answers: probabilities (N, labels), true gestures (N,)."""

    probabilities: Floats
    gestures: NDArray[np.str_]
    labels: tuple[str, ...]

    @property
    def other(self) -> Floats:
        """The probabilities of `other` (N,)."""
        return self.probabilities[:, self.labels.index(OTHER)]

    @property
    def named(self) -> Floats:
        """The highest probability of a known gesture (N,)."""
        known = [place for place, label in enumerate(self.labels) if label != OTHER]
        best: Floats = self.probabilities[:, known].max(axis=1)
        return best


def ask(split: Split, length: int) -> Asked:
    """Ask each network about its recordings' windows."""
    probabilities, gestures = [], []
    for classifier, recordings in split:
        for recording in recordings:
            starts = range(0, len(recording.counts) - length + 1, length)
            cut = np.stack([recording.counts[start : start + length] for start in starts])
            probabilities.append(answer(classifier, cut.astype(np.float32)))
            gestures += [recording.gesture] * len(cut)
    return Asked(np.concatenate(probabilities), np.array(gestures), split[0][0].labels)


def auroc(positive: Floats, negative: Floats) -> float:
    """Return the probability that a positive's score is higher than a negative's."""
    ranks = np.concatenate([positive, negative]).argsort().argsort() + 1
    above = ranks[: len(positive)].sum() - len(positive) * (len(positive) + 1) / 2
    return float(above / (len(positive) * len(negative)))


def windows(others: Split, known: Split, length: int) -> Windows:
    """Return the figures of windows of one length."""
    strange, usual = ask(others, length), ask(known, length)
    touched = usual.other[usual.gestures != NO_TOUCH]
    is_named = strange.named >= SURE
    return Windows(
        frames=length,
        n=len(strange.gestures),
        named=_percent(is_named),
        other=_percent(strange.probabilities.argmax(axis=1) == strange.labels.index(OTHER)),
        auroc=round(auroc(strange.other, touched), 3),
        by_gesture={
            str(name): _percent(is_named[strange.gestures == name]) for name in np.unique(strange.gestures)
        },
    )


def lost(people: str, split: Split) -> Lost:
    """Return how much of the gestures themselves is answered `other`."""
    after, by_gesture = {}, {}
    for length in (54, 81, 144):
        asked = ask(split, length)
        is_lost = asked.probabilities.argmax(axis=1) == asked.labels.index(OTHER)
        touched = asked.gestures != NO_TOUCH
        after[f"{length}"] = _percent(is_lost[touched])
        by_gesture = {
            str(name): _percent(is_lost[asked.gestures == name]) for name in np.unique(asked.gestures)
        }
    return Lost(people=people, after=after, by_gesture=by_gesture)


def trade(others: Split, known: Split) -> list[Trade]:
    """Return the share named over the share lost, of windows of 2.67 s."""
    strange, usual = ask(others, LENGTHS[-1]), ask(known, LENGTHS[-1])
    touched = usual.other[usual.gestures != NO_TOUCH]
    return [
        Trade(
            limit=limit,
            named=_percent((strange.named >= SURE) & (strange.other < limit)),
            lost=_percent(touched >= limit),
        )
        for limit in LIMITS
    ]


def told(played: Sequence[Sequence[Event]], right: str = "") -> Told:
    """Return what the robot was told of touches, each played on its own."""
    answers = [
        [event for event in events if isinstance(event, Prediction) and event.told] for events in played
    ]
    known = [[each for each in own if each.gesture not in (OTHER, UNCERTAIN)] for own in answers]

    def share(limit: float) -> float:
        return _percent(np.array([any(each.confidence >= limit for each in own) for own in known]))

    return Told(
        n=len(played),
        known=share(0.0),
        known_sure=share(SURE),
        known_very_sure=share(VERY_SURE),
        other=_percent(np.array([any(each.gesture == OTHER for each in own) for own in answers])),
        right=_percent(np.array([own[-1:] != [] and own[-1].gesture == right for own in answers])),
    )


def disc(row: float, column: float, radius: float) -> Floats:
    """Return a contact (8, 8) of height 1 that ends at a radius, as of something with an edge."""
    away = np.hypot(ROW - row, COLUMN - column) / radius
    return np.where(away < 1.0, np.cos(0.5 * math.pi * away.clip(0.0, 1.0)) ** 0.7, 0.0)


def blow(rng: Generator) -> Floats:
    """Three to five frames of 300 to 900 counts over most of the pad, gone at once."""
    frames = rng.integers(3, 6)
    pressed = rng.uniform(300.0, 900.0) * rng.uniform(0.8, 1.0, (frames, 1, 1))
    row, column, radius = rng.uniform(2.0, 5.0), rng.uniform(2.0, 5.0), rng.uniform(4.0, 9.0)
    struck: Floats = pressed * disc(row, column, radius)
    return struck


def squeeze(rng: Generator) -> Floats:
    """Two contacts that move towards one another for a second and a half."""
    angle, (row, column) = rng.uniform(0.0, math.pi), rng.uniform(2.8, 4.2, 2)
    frames = round(1.5 * FRAME_RATE_HZ)
    made = np.zeros((frames, ROWS, COLUMNS))
    for frame in range(frames):
        apart = 3.0 - 2.2 * frame / frames
        force = min(1.0, (frame + 1) / 6.0, (frames - frame) / 4.0)
        for side in (-apart, apart):
            made[frame] += force * disc(row + side * math.sin(angle), column + side * math.cos(angle), 1.8)
    return made * rng.uniform(80.0, 500.0)


def on_rests(touch: Floats, rest: NDArray[np.generic]) -> Counts:
    """Return rest, the touch on it, and rest."""
    frames = REST_FRAMES + len(touch) + AFTER_FRAMES
    whole = np.resize(rest, (frames, ROWS, COLUMNS)).astype(np.float64)
    whole[REST_FRAMES : REST_FRAMES + len(touch)] += touch
    return whole.clip(0, MAX_COUNT).astype(np.uint16)


def caress(lasts_s: float, seed: int) -> Counts:
    """Return the page's hand drawn once over a simulated pad in some seconds, with rest around."""
    rng = RandomState(seed)
    fabric, hands = Fabric(rng), PressingHands(rng)
    frames = round(lasts_s * FRAME_RATE_HZ)
    heading = rng.choice([0.0, 0.5, 1.0, 1.5]) * math.pi + rng.normal(0.0, 0.2)
    beside = rng.normal(0.0, 0.7)
    pressed = [np.zeros((ROWS, COLUMNS))] * REST_FRAMES
    for frame in range(frames):
        way = 6.6 * (frame / frames - 0.5)
        row = 3.5 + way * math.sin(heading) + beside * math.cos(heading)
        column = 3.5 + way * math.cos(heading) - beside * math.sin(heading)
        pressed.append(hands.frame({0: Pointer(row, column, "hand")}))
    pressed += [hands.frame({}) for _ in range(AFTER_FRAMES)]
    return fabric.read(np.stack(pressed))


def firm_touches(folder: Path) -> Iterator[Counts]:
    """Yield the recordings of a firm, coarse pad whose touches are none of the gestures, on 8x8 and 54 Hz."""
    layout = Layout(PadFormat(framing="text", rows=firm_pad.ROWS, columns=firm_pad.COLUMNS))
    for stream in firm_pad.read(folder):
        if stream.name.startswith(FIRM):
            cells = stream.frames.reshape(len(stream.frames), -1).clip(0).astype(np.uint16)
            counts = np.stack([layout.pressure(scan) for scan in cells])
            clock = (np.arange(len(counts)) * 1000.0 / FIRM_HZ).astype(np.int64)
            laid = on_grid(Recording(stream.name, "", "", OTHER, counts, clock, "live"))
            yield laid.counts.astype(np.uint16)


def by_touch(events: Sequence[Event]) -> list[list[Event]]:
    """Return the answers to each touch of a stream."""
    answers: dict[int, list[Event]] = {}
    for event in events:
        if isinstance(event, Prediction):
            answers.setdefault(event.touch, []).append(event)
    return [*answers.values()]


def measure(folders: Folders, weights: Path, firm: Path | None) -> Measured:
    """Measure everything. firm: folder of the firm pad's recordings; None: no figures of it."""
    people = never_seen(folders, weights)
    third, ((shipped, test),) = people[THIRD], people[TEST]
    strange = left_out_split(weights, folders.others(("third",)))
    rests = [each.counts for each in test if each.gesture == NO_TOUCH]
    rng = np.random.default_rng(11)
    blows, squeezes = (_played(shipped, maker, rests, rng) for maker in (blow, squeeze))
    return Measured(
        model=shipped.name,
        windows=[windows(strange, third, length) for length in LENGTHS],
        lost=[lost(name, split) for name, split in people.items()],
        trade=trade(strange, third),
        streams=told(_other_streams(folders)),
        made={"blow": told(blows), "squeeze": told(squeezes)},
        blows_called_pat=_percent(np.array([any(map(_is_sure_pat, events)) for events in blows])),
        caresses={f"{lasts_s:g}": _caressed(shipped, lasts_s) for lasts_s in SPEEDS_S},
        firm_pad=None if firm is None else _on_firm_pad(shipped, firm),
    )


def _played(
    shipped: Classifier, maker: Callable[[Generator], Floats], rests: Sequence[NDArray[Any]], rng: Generator
) -> list[list[Event]]:
    """Return the events of made touches, each on a rest of HAART's test participants."""
    made = [on_rests(maker(rng), rests[int(rng.integers(len(rests)))]) for _ in range(MADE)]
    return [play(frames_of(counts), shipped, flush=True) for counts in made]


def _caressed(shipped: Classifier, lasts_s: float) -> Told:
    made = (caress(lasts_s, seed) for seed in range(CARESSES))
    return told([play(frames_of(counts), shipped, flush=True) for counts in made], "stroke")


def _other_streams(folders: Folders) -> list[list[Event]]:
    """Return the events of the third study's streams of touches that are none of the gestures."""
    models, named = streams.held_out(), third_study.OTHERS
    found = streams.read(folders.third_study, others=named)
    return [
        play(streams.frames_of(each), models[each.participant], streams.SETTINGS, flush=True)
        for each in found
        if each.gesture in named
    ]


def _on_firm_pad(shipped: Classifier, firm_pad: Path) -> Told:
    each = [by_touch(play(frames_of(counts), shipped, flush=True)) for counts in firm_touches(firm_pad)]
    return told([touch for touches in each for touch in touches])


def _is_sure_pat(event: Event) -> bool:
    if not isinstance(event, Prediction):
        return False
    return event.told and event.gesture == "pat" and event.confidence >= VERY_SURE


def _percent(mask: NDArray[np.bool_]) -> float:
    return round(100.0 * float(mask.mean()), 1) if len(mask) else 0.0


def tables(measured: Measured) -> dict[str, str]:
    """Return the page's tables."""
    rows = [("pinch, poke, twist, knead, massage, fist, karate, type", measured.streams)]
    rows += [(f"made: {name}", made) for name, made in measured.made.items()]
    rows += [("hug, grab, squeeze, punch on a firm pad", measured.firm_pad)] if measured.firm_pad else []
    heads = ("touch", "number", "told a gesture, %", "with 0.65 or more", "told other")
    speeds = measured.caresses
    return {
        "others": table(heads, [(name, t.n, t.known, t.known_very_sure, t.other) for name, t in rows]),
        "trade": table(
            ("`other` counts from", *(f"{at.limit:g}" for at in measured.trade)),
            [("eight others named / six lost, %", *(f"{at.named:g} / {at.lost:g}" for at in measured.trade))],
        ),
        "caresses": table(
            ("a caress of", *(f"{seconds} s" for seconds in speeds)),
            [("told stroke, %", *(f"{told.right}" for told in speeds.values()))],
        ),
    }


def main(arguments: Sequence[str]) -> int:
    """Measure, store the figures and fill the page; returns 0."""
    options = study_parser("others", __doc__, *STUDIES, "docs", "weights", "firm-pad").parse_args(arguments)
    # Silence the daemon's log, which would report on every stream.
    logging.disable()
    measured = measure(folders_of(options), options.weights, options.firm_pad)
    keep(FILE, measured)
    fill(options.docs / "accuracy.md", tables(measured))
    return 0
