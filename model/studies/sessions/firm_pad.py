"""A firm, fine pad that touchd never learns from, played through the parser and the pipeline.

19x27 cells on a body that is hugged, grabbed, punched and stroked (mdethmers/Social-Touch-Research).
A touch leaves a residue there, and rest drifts. The recordings carry no times; 8 to 12 frames a second are
likely. A touch is true where the summed rise above a local floor says so, and where the authors marked one if
they marked any in that recording.
"""

import csv
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from itertools import groupby, pairwise
from pathlib import Path

import msgspec
import numpy as np
from numpy.typing import NDArray

from touchd.daemon.app.config import SensorSettings, Settings
from touchd.daemon.path.events import Event, TouchBegan, epoch_s
from touchd.drivers.frame import Frame
from touchd.drivers.pad.format import PadFormat
from touchd.drivers.pad.parser import FrameParser
from touchd.model.classifier import Classifier
from touchd.model.studies.play import Player, play
from touchd.model.studies.sessions.score import detected_in
from touchd.model.training.haart import open_table

FILE = "streams.csv"
ROWS, COLUMNS = 19, 27
PAD = PadFormat(framing="text", rows=ROWS, columns=COLUMNS, skip=1, clock="ms", full_scale=1023)
SETTINGS = Settings(sensor=SensorSettings(format=PAD)).pipeline
START_MS = 5000
# Above the recording's own rest, 10th percentile: counts of a cell, and of the sum, that a hand makes.
CELL_COUNTS, LEAST_ON_COUNTS, LEAST_OFF_COUNTS, LEAST_SPAN_COUNTS = 3, 800, 300, 1000
ON_SHARE, OFF_SHARE = 0.35, 0.15
FLOOR_S, JOINED_S, QUIET_S = 6.0, 0.5, 1.5
# What counts as a fault of detection, in seconds.
PAUSE_S, OPEN_S, LATE_S = 1.5, 2.5, 1.0


class FirmScore(msgspec.Struct, frozen=True, kw_only=True):
    """Counts of touches. merged: pauses of more than 1.5 s within one. open: 2.5 s after the hand has left.

    late: begun more than 1 s late. false: begun in quiet.
    """

    truth: int
    found: int
    missed: int
    late: int
    merged: int
    open: int
    false: int


@dataclass(frozen=True, eq=False)
class FirmStream:
    """Frames (T, 19, 27), and whether the authors marked a touch in each; None where they marked nothing."""

    name: str
    frames: NDArray[np.int64]
    marked: NDArray[np.bool_] | None


Span = tuple[float, float]


def read(folder: Path) -> Iterator[FirmStream]:
    """Yield the recordings; raises RecordingError without the file."""
    with open_table(folder, FILE, "name its folder: --firm-pad") as file:
        rows = csv.reader(file)
        next(rows)
        for name, group in groupby(rows, lambda row: row[0]):
            own = list(group)
            cells = np.array([[int(cell) for cell in row[3:]] for row in own]).reshape(-1, ROWS, COLUMNS)
            marked = None if own[0][2] == "" else np.array([row[2] == "1" for row in own])
            yield FirmStream(name, cells, marked)


def truth(stream: FirmStream, hz: float) -> tuple[list[Span], list[Span]]:
    """Return where the pad is touched and where it is quiet, in seconds."""
    rest = np.percentile(stream.frames, 10, axis=0)
    level = np.maximum(stream.frames - rest - CELL_COUNTS, 0).sum(axis=(1, 2))
    smooth = np.array([np.median(level[max(0, i - 1) : i + 2]) for i in range(len(level))])
    half = round(FLOOR_S * hz)
    around = [smooth[max(0, i - half) : i + half + 1] for i in range(len(level))]
    floor, top = np.array([each.min() for each in around]), np.array([each.max() for each in around])
    span = top - floor
    on = floor + np.maximum(ON_SHARE * span, LEAST_ON_COUNTS)
    off = floor + np.maximum(OFF_SHARE * span, LEAST_OFF_COUNTS)
    touched = level > off
    for first, last in _runs(touched):
        if not (level[first : last + 1] > on[first : last + 1]).any():
            touched[first : last + 1] = False
    touched &= span > LEAST_SPAN_COUNTS
    quiet = level <= off
    if stream.marked is not None:
        quiet &= ~stream.marked
    touches = _joined(_runs(touched), stream.marked, JOINED_S * hz)
    quiets = [(first, last) for first, last in _runs(quiet) if last - first >= QUIET_S * hz]
    return [(a / hz, b / hz) for a, b in touches], [(a / hz, b / hz) for a, b in quiets]


def _joined(
    runs: Iterable[tuple[int, int]], marked: NDArray[np.bool_] | None, most_frames: float
) -> list[tuple[int, int]]:
    """Join runs at most this many frames apart; leave out those that the authors did not mark."""
    touches: list[tuple[int, int]] = []
    for first, last in runs:
        if marked is not None and not marked[max(0, first - 3) : last + 4].any():
            continue
        if touches and first - touches[-1][1] <= most_frames:
            touches[-1] = (touches[-1][0], last)
        else:
            touches.append((first, last))
    return touches


def frames_of(stream: FirmStream, hz: float, rate_hz: float) -> Iterator[Frame]:
    """Yield the frames that the daemon's parser finds in such a recording."""
    count = int((len(stream.frames) - 1) * rate_hz / hz)
    at = np.arange(count) * hz / rate_hz
    low = at.astype(int)
    share = (at - low)[:, None, None]
    high = stream.frames[np.minimum(low + 1, len(stream.frames) - 1)]
    laid = np.rint(stream.frames[low] * (1 - share) + high * share).astype(int)
    parser = FrameParser(PAD)
    for i, cells in enumerate(laid):
        now_s = i / rate_hz
        line = ",".join(map(str, [START_MS + round(1000 * now_s), *cells.ravel()]))
        yield from parser.feed(f"{line}\n".encode(), now_s)


def score(stream: FirmStream, events: Sequence[Event], hz: float) -> FirmScore:
    """Compare the daemon's touches with the true ones."""
    touches, quiets = truth(stream, hz)
    length_s = len(stream.frames) / hz
    found = _found(events, length_s)
    # A touch ends `quiet_s` after its last contact.
    hits = [[each for each in found if each[0] <= last + 1.0 and each[1] >= first] for first, last in touches]
    pauses = list(pairwise(touches))
    spans = zip(touches, hits, [*(one[0] for one in touches[1:]), length_s], strict=True)
    return FirmScore(
        truth=len(touches),
        found=len(found),
        missed=sum(not own for own in hits),
        late=sum(
            bool(own) and own[0][0] > first + LATE_S for (first, _), own in zip(touches, hits, strict=True)
        ),
        merged=sum(
            two[0] - one[1] > PAUSE_S and any(each[0] <= one[1] and each[1] >= two[0] for each in found)
            for one, two in pauses
        ),
        open=sum(
            following - last > OPEN_S and any(each[0] <= last and each[1] > last + OPEN_S for each in own)
            for (_, last), own, following in spans
        ),
        false=sum(
            any(first + 1.2 < each[0] < last - 0.3 for first, last in quiets)
            and not any(first - 1 <= each[0] <= last + 1.2 for first, last in touches)
            for each in found
        ),
    )


def _found(events: Sequence[Event], length_s: float) -> list[Span]:
    """Return when each touch was reported to begin and to end, by the clock."""
    began = [epoch_s(event.time) for event in events if isinstance(event, TouchBegan)]
    over = [each.over_ms / 1000.0 for each in detected_in(events)]
    return [(first, min(last, length_s + 1)) for first, last in zip(began, over, strict=True)]


def measure(folder: Path, model: Classifier, hz: float, rate_hz: float, player: Player = play) -> FirmScore:
    """Play every recording, and return the sum of each count."""
    scores = [score(each, player(frames_of(each, hz, rate_hz), model, SETTINGS), hz) for each in read(folder)]
    return FirmScore(
        **{name: sum(getattr(each, name) for each in scores) for name in FirmScore.__struct_fields__}
    )


def _runs(mask: NDArray[np.bool_]) -> list[tuple[int, int]]:
    """Return where a mask (T,) is true, as (first, last)."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], mask, [False]]).astype(np.int8)))
    return [(int(first), int(stop) - 1) for first, stop in edges.reshape(-1, 2)]
