"""Composes the detector's training data at random from recordings: rest, touches, and what touches leave.

A piece is ten seconds of one person on one set-up. The recordings show hands in the middle of a gesture, and
the same pad at rest; a piece joins them as a pad in use would send them.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from touchd.drivers.frame import COLUMNS, FRAME_RATE_HZ, MAX_COUNT, NO_TOUCH, ROWS
from touchd.drivers.recording import Recording, setup_of
from touchd.model.training.contacts import LEAVES, contacts, lightest, shift_of_rest
from touchd.model.training.detector.disturb import disturbed, read_by_another_pad
from touchd.model.training.studies import study_of

PIECE_FRAMES = 567
Scans = NDArray[np.float32]
# A frame of a touch shows a hand if the counts above rest and taxel noise sum up to this. Other frames of a
# touch have no weight in the loss.
VISIBLE_COUNTS, TAXEL_NOISE_COUNTS = 10.0, 2.5
# Frames this close to the beginning or end of a touch have no weight either.
BESIDE_FRAMES = 2
# Nor do frames in which an arriving or leaving hand has less than this share of its load.
SEEN_SHARE = 0.15
# Share of the touches that are hugs, which no study has recorded; share of the pieces without a touch.
HUGS, IDLE = 0.2, 0.1
# The residue of a touch, as a share of its load, and its probability.
RESIDUES = ((0.0, 0.35), (0.01, 0.2), (0.03, 0.2), (0.08, 0.15), (0.2, 0.1))
LEAVING = (*LEAVES, "tickle")


@dataclass(frozen=True, eq=False)
class Touch:
    """A recorded touch. contacts: complete ones of a pat or stroke. shift: of the rest, by the touch."""

    gesture: str
    scans: Scans
    visible: NDArray[np.bool_]
    contacts: tuple[tuple[int, int], ...]
    shift: Scans


@dataclass(frozen=True, eq=False)
class SetUp:
    """One person on one set-up: the pad at rest, and the touches."""

    rests: tuple[Scans, ...]
    touches: tuple[Touch, ...]


@dataclass(frozen=True, eq=False)
class Streamed:
    """An uncut recording, and in which frames the hand is on the pad."""

    scans: Scans
    touched: NDArray[np.bool_]


@dataclass(frozen=True, eq=False)
class Piece:
    """counts (T, 64), targets (T,) 0 or 1, weights (T,) of each frame in the loss."""

    counts: Scans
    targets: Scans
    weights: Scans


def set_ups(recordings: Sequence[Recording]) -> list[SetUp]:
    """Return the set-ups that have a recording at rest."""
    by_set_up: dict[object, list[Recording]] = {}
    for recording in recordings:
        by_set_up.setdefault(setup_of(recording), []).append(recording)
    found = []
    for own in by_set_up.values():
        rests = [np.asarray(one.counts, np.float32) for one in own if one.gesture == NO_TOUCH]
        if rests:
            touches = tuple(_touch(one, rests[0]) for one in own if one.gesture != NO_TOUCH)
            found.append(SetUp(tuple(rests), touches))
    return found


def _touch(recording: Recording, rest: Scans) -> Touch:
    scans = np.asarray(recording.counts, np.float32)
    own_rest = np.median(rest, axis=0)
    if recording.gesture in LEAVING:
        own_rest = np.minimum(lightest(scans), own_rest + 8.0)
    above = np.maximum(scans - own_rest - TAXEL_NOISE_COUNTS, 0.0).sum(axis=(1, 2))
    visible = np.convolve(above, np.full(3, 1 / 3), "same") > VISIBLE_COUNTS
    whole = contacts(recording, is_soft=study_of(recording.participant) == "third")
    if recording.gesture not in LEAVES:
        whole = []
    shift = np.zeros((ROWS, COLUMNS), np.float32)
    if recording.gesture in LEAVING:
        shift = shift_of_rest(scans, rest)
    return Touch(recording.gesture, scans, visible, tuple(whole), shift)


class Composer:
    """Composes pieces. set_ups: by study, each drawn equally often; streams: uncut recordings, or none."""

    def __init__(self, by_study: Sequence[Sequence[SetUp]], streams: Sequence[Streamed], seed: int) -> None:
        self._by_study = [own for own in by_study if own]
        self._streams = streams
        self.rng = np.random.default_rng(seed)

    def piece(self) -> Piece:
        """Return a piece of PIECE_FRAMES frames."""
        rng = self.rng
        if self._streams and rng.random() < 0.12:
            counts, targets, weights = self._streamed()
        else:
            own = self._by_study[int(rng.integers(len(self._by_study)))]
            counts, targets, weights = self._composed(own[int(rng.integers(len(own)))])
        counts = read_by_another_pad(counts, rng)
        counts = disturbed(counts, rng)
        counts = np.clip(np.rint(counts) if rng.random() < 0.65 else counts, 0, MAX_COUNT)
        return Piece(counts.reshape(-1, ROWS * COLUMNS).astype(np.float32), targets, weights)

    def _streamed(self) -> tuple[Scans, Scans, Scans]:
        rng = self.rng
        stream = self._streams[int(rng.integers(len(self._streams)))]
        lead = int(rng.integers(30, 120))
        at = np.concatenate([np.zeros(lead, int), np.arange(len(stream.scans))])
        start = int(rng.integers(max(1, len(at) - PIECE_FRAMES + 1)))
        at = np.minimum(at[start : start + PIECE_FRAMES], len(stream.scans) - 1)
        at = np.concatenate([at, np.full(PIECE_FRAMES - len(at), at[-1])])
        targets = stream.touched[at].astype(np.float32)
        # The person labelled the beginning and end of the touch to some tenths of a second.
        weights = np.where(_beside(targets, 16), 0.0, 1.0).astype(np.float32)
        if targets[:30].any():
            weights[:] = 0.0
        return stream.scans[at], targets, weights

    def _composed(self, own: SetUp) -> tuple[Scans, Scans, Scans]:
        rng = self.rng
        rest = _stretch(own.rests[int(rng.integers(len(own.rests)))], PIECE_FRAMES, rng)
        at = int(rng.integers(32, 160))
        line = _TimeLine(rest, rng)
        if rng.random() < IDLE or not own.touches:
            at = PIECE_FRAMES
        while at < PIECE_FRAMES - 20:
            is_hug = rng.random() < HUGS
            touch = _hug(line.level, rng) if is_hug else own.touches[int(rng.integers(len(own.touches)))]
            first, stop = (0, len(touch.scans)) if is_hug else _cut(touch, rng)
            stop = min(stop, first + PIECE_FRAMES - at)
            line.lay(touch, first, stop, at)
            at += stop - first
            if at < PIECE_FRAMES:
                line.leave(touch, first, stop, at)
            at += int(rng.integers(16, 60) if rng.random() < 0.25 else rng.integers(60, 260))
        line.weights[_beside(line.targets, BESIDE_FRAMES)] = 0.0
        return line.counts + line.left, line.targets, line.weights


class _TimeLine:
    """A piece that is being composed: rest, the touches laid on it, and what they leave."""

    def __init__(self, rest: Scans, rng: np.random.Generator) -> None:
        self._rng = rng
        self.counts = rest.copy()
        self.targets = np.zeros(PIECE_FRAMES, np.float32)
        self.weights = np.ones(PIECE_FRAMES, np.float32)
        self.left = np.zeros((PIECE_FRAMES, ROWS, COLUMNS), np.float32)
        self.level: Scans = np.median(rest[:54], axis=0)
        shares, often = zip(*RESIDUES, strict=True)
        self._residue_share = rng.choice(shares, p=often) * rng.uniform(0.3, 1.5)
        self._residue_s = float(np.exp(rng.uniform(np.log(0.15), np.log(30.0))))

    def lay(self, touch: Touch, first: int, stop: int, at: int) -> None:
        """Lay frames first <= i < stop of a touch on the frames from `at` on."""
        faded = _faded(stop - first, self._rng)
        span = slice(at, at + stop - first)
        self.counts[span] += (touch.scans[first:stop] - self.counts[span]) * faded[:, None, None]
        self.targets[span] = 1.0
        self.weights[span] *= touch.visible[first:stop] & (faded > SEEN_SHARE)

    def leave(self, touch: Touch, first: int, stop: int, at: int) -> None:
        """Add what a touch leaves to the frames from `at` on: a shifted rest, a residue that creeps back."""
        rng = self._rng
        if touch.gesture in LEAVING and rng.random() < 0.75:
            self.counts[at:] += touch.shift * np.float32(rng.uniform(0.3, 1.5))
        elif rng.random() < 0.3:
            self.counts[at:] += _blotch(rng) * np.float32(rng.uniform(1.0, 8.0))
        if self._residue_share:
            load = np.maximum(touch.scans[first:stop] - self.level, 0.0)
            picture = load[-54:].mean(axis=0) if rng.random() < 0.5 else load.max(axis=0)
            after = np.arange(PIECE_FRAMES - at, dtype=np.float32)[:, None, None]
            creep = np.exp(-after / np.float32(self._residue_s * FRAME_RATE_HZ))
            self.left[at:] += self._residue_share * picture * creep


def _hug(level: Scans, rng: np.random.Generator) -> Touch:
    """Return one or two arms around the pad: firm, wide, moving a little, for 0.5 to 4 s."""
    frames = int(rng.integers(20, 220))
    y, x = np.mgrid[:ROWS, :COLUMNS]
    at_s = np.arange(frames, dtype=np.float32) / FRAME_RATE_HZ
    picture = np.zeros((frames, ROWS, COLUMNS), np.float32)
    for _ in range(int(rng.integers(1, 4))):
        place, size = rng.uniform(0.0, 7.0, 2), rng.uniform(1.2, 5.0, 2)
        sway = 0.5 * np.sin(2 * np.pi * (rng.uniform(0.1, 1.5) * at_s + rng.random()))[:, None, None]
        force = 1.0 + 0.3 * np.sin(2 * np.pi * (rng.uniform(0.2, 3.0) * at_s + rng.random()))[:, None, None]
        shape = -(((y - place[0] - sway) / size[0]) ** 2) - ((x - place[1] + sway) / size[1]) ** 2
        picture += (force * np.exp(shape)).astype(np.float32)
    rise, fall = rng.integers(1, 40, 2)
    ticks = np.arange(frames)
    held = np.clip(np.minimum((ticks + 1) / rise, (frames - ticks) / fall), 0.0, 1.0)[:, None, None]
    scans = level + picture * held.astype(np.float32) * np.float32(
        np.exp(rng.uniform(np.log(8), np.log(150)))
    )
    visible = (scans - level).sum(axis=(1, 2)) > VISIBLE_COUNTS + 0.1 * (scans - level).sum(axis=(1, 2)).max()
    return Touch("constant", scans, visible, (), np.zeros((ROWS, COLUMNS), np.float32))


def _cut(touch: Touch, rng: np.random.Generator) -> tuple[int, int]:
    """Return the first frame and one after the last: complete contacts, a moment, or some seconds."""
    length = len(touch.scans)
    if touch.contacts and rng.random() < 0.5:
        first = int(rng.integers(len(touch.contacts)))
        last = min(len(touch.contacts) - 1, first + int(rng.integers(3)))
        return touch.contacts[first][0], touch.contacts[last][1]
    frames = int(rng.integers(8, 110)) if rng.random() < 0.4 else int(rng.integers(110, 430))
    frames = min(frames, length)
    first = int(rng.integers(length - frames + 1))
    return first, first + frames


def _faded(length: int, rng: np.random.Generator) -> Scans:
    """Return (T,) the share of the hand's load, which rises at once, within some frames, or slowly."""
    most = (1, 5, 30)[rng.choice(3, p=[0.45, 0.4, 0.15])]
    rise, fall = rng.integers(1, most + 1, 2)
    ticks = np.arange(length)
    faded = np.minimum((ticks + 1) / rise, (length - ticks) / fall)
    clipped: Scans = np.clip(faded, 0.0, 1.0).astype(np.float32)
    return clipped


def _stretch(scans: Scans, frames: int, rng: np.random.Generator) -> Scans:
    """Return `frames` frames of a recording from a random place on, back and forth if it is shorter."""
    there_and_back = np.concatenate([np.arange(len(scans)), np.arange(len(scans) - 2, 0, -1)])
    at = there_and_back[(int(rng.integers(len(there_and_back))) + np.arange(frames)) % len(there_and_back)]
    stretched: Scans = scans[at].copy()
    return stretched


def _blotch(rng: np.random.Generator) -> Scans:
    """Return (8, 8) from -1 to 1: a fold of the fabric, somewhere on the pad."""
    y, x = np.mgrid[:ROWS, :COLUMNS]
    place, size = rng.uniform(-0.5, 7.5, 2), rng.uniform(0.7, 3.5, 2)
    blotch = np.exp(-(((y - place[0]) / size[0]) ** 2) - ((x - place[1]) / size[1]) ** 2)
    signed: Scans = (blotch * rng.choice([-1.0, 1.0, 1.0])).astype(np.float32)
    return signed


def _beside(targets: Scans, frames: int) -> NDArray[np.bool_]:
    """Return which frames are close to the beginning or end of a touch."""
    edges = np.flatnonzero(np.diff(targets)) + 1
    near = np.zeros(len(targets), np.bool_)
    for edge in edges:
        near[max(0, edge - frames) : edge + frames] = True
    return near
