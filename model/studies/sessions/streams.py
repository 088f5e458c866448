"""The third study's uncut recordings, played as its pad sends them.

Each row becomes a line of text, the pad's clock and 36 numbers, and goes through the daemon's parser and
pipeline with a network that never saw the person. Before the first row the pad rests for two seconds.
"""

import csv
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import cycle, groupby, islice
from pathlib import Path

import msgspec
import numpy as np

from touchd.daemon.app.config import SceneSettings, SensorSettings, Settings
from touchd.daemon.path.events import UNCERTAIN, Event, Prediction, TouchBegan, TouchEnded
from touchd.drivers.frame import NO_TOUCH, Frame
from touchd.drivers.pad.format import PadFormat
from touchd.drivers.pad.parser import FrameParser
from touchd.model.classifier import SHIPPED_MODEL, Classifier
from touchd.model.studies.play import Player, play
from touchd.model.training.haart import open_table
from touchd.model.training.weights import LEFT_OUT_FOLDER

FILE = "streams.csv"
PAD = PadFormat(framing="text", rows=6, columns=6, skip=1, clock="ms")
NAMES = {name: name for name in ("constant", NO_TOUCH, "pat", "rub", "scratch")} | {
    "outward_caress": "stroke"
}
SCENE = SceneSettings(gestures=tuple(sorted({*NAMES.values()} - {NO_TOUCH})))
SETTINGS = Settings(sensor=SensorSettings(format=PAD), scene=SCENE).pipeline
REST_S, RATE_HZ, REST_ROWS = 2.0, 45, 8


class StreamScore(msgspec.Struct, frozen=True, kw_only=True):
    """Counts of streams, each of one person and gesture.

    touched: streams with a touch; missed: in which none was detected; several: more than one. named: in which
    the robot was told a gesture; right: the last one told was the right one. rest: streams without a touch;
    false: in which one was detected.
    """

    touched: int
    missed: int
    several: int
    named: int
    right: int
    rest: int
    false: int


@dataclass(frozen=True)
class Stream:
    """Lines with their time since the first, and when the person began and ended the touch; None at rest."""

    participant: str
    gesture: str
    lines: tuple[tuple[float, bytes], ...]
    touched_s: tuple[float, float] | None


def read(folder: Path, rest_counts: int = 0, others: Collection[str] = ()) -> Iterator[Stream]:
    """Yield the streams of gestures that touchd has a name for; raises RecordingError without the file.

    rest_counts: mean offset added to the pad's cells; single cells deviate from it by up to half of it.
    others: further gestures to read.
    """
    names = {**NAMES, **{name: name for name in others}}
    with open_table(folder, FILE, "name its folder: --third-study") as file:
        for (_, participant, gesture), group in groupby(
            csv.DictReader(file), lambda row: (row["stream"], row["participant"], row["gesture"])
        ):
            if gesture in names:
                yield _stream(participant, names[gesture], list(group), rest_counts)


def _stream(participant: str, gesture: str, rows: Sequence[dict[str, str]], rest_counts: int) -> Stream:
    rest = np.rint(rest_counts * np.random.default_rng(0).uniform(0.5, 1.5, PAD.cells)).astype(int)
    names = [f"c{number}" for number in range(1, PAD.cells + 1)]
    cells = [
        ",".join(str(int(row[name]) + more) for name, more in zip(names, rest, strict=True)) for row in rows
    ]
    first_ms = float(rows[0]["ms"])
    at_s = [REST_S + (float(row["ms"]) - first_ms) / 1000 for row in rows]
    resting = islice(cycle(cells[:REST_ROWS]), round(REST_S * RATE_HZ))
    timed = [*((i / RATE_HZ, line) for i, line in enumerate(resting)), *zip(at_s, cells, strict=True)]
    labelled_s = [now_s for now_s, row in zip(at_s, rows, strict=True) if row["label"]]
    is_touched = gesture != NO_TOUCH and labelled_s
    return Stream(
        participant,
        gesture,
        tuple((now_s, f"{round(1000 * now_s)},{line}\n".encode()) for now_s, line in timed),
        (labelled_s[0], labelled_s[-1]) if is_touched else None,
    )


def frames_of(stream: Stream) -> Iterator[Frame]:
    """Yield a stream's frames as the daemon's parser finds them."""
    parser = FrameParser(PAD)
    for now_s, line in stream.lines:
        yield from parser.feed(line, now_s)


def score(played: Sequence[tuple[Stream, Sequence[Event]]]) -> StreamScore:
    """Return the figures of these streams together."""
    touched = [
        (stream, _detected(stream.touched_s, events), events) for stream, events in played if stream.touched_s
    ]
    rest = [events for stream, events in played if stream.gesture == NO_TOUCH]
    named = [(stream, told[-1]) for stream, touches, events in touched if (told := _told(events, touches))]
    return StreamScore(
        touched=len(touched),
        missed=sum(not touches for _, touches, _ in touched),
        several=sum(len(touches) > 1 for _, touches, _ in touched),
        named=len(named),
        right=sum(gesture == stream.gesture for stream, gesture in named),
        rest=len(rest),
        false=sum(any(isinstance(event, TouchBegan) for event in events) for events in rest),
    )


def _detected(touched_s: tuple[float, float], events: Sequence[Event]) -> set[int]:
    """Return the numbers of the touches whose contact overlaps that of the person."""
    began_ms = {event.touch: event.sensor_ms for event in events if isinstance(event, TouchBegan)}
    ended_ms = {event.touch: event.sensor_ms or 0 for event in events if isinstance(event, TouchEnded)}
    first_ms, last_ms = (1000 * at_s for at_s in touched_s)
    return {touch for touch, ms in began_ms.items() if ms <= last_ms and ended_ms[touch] >= first_ms}


def _told(events: Sequence[Event], touches: set[int]) -> list[str]:
    answers = [event for event in events if isinstance(event, Prediction) and event.touch in touches]
    return [answer.gesture for answer in answers if answer.told and answer.gesture != UNCERTAIN]


def measure(
    folder: Path, models: Mapping[str, Classifier], rest_counts: int = 0, player: Player = play
) -> StreamScore:
    """Play every stream with the model of its person, and score them together."""
    return score(
        [
            (stream, player(frames_of(stream), models[stream.participant], SETTINGS, flush=True))
            for stream in read(folder, rest_counts)
        ]
    )


def held_out() -> dict[str, Classifier]:
    """Return, for each participant, the network of the fold that never saw this person."""
    paths = sorted((SHIPPED_MODEL.parent / LEFT_OUT_FOLDER).glob("*.onnx"))
    models = {path: Classifier.load(path) for path in paths}
    return {name: model for path, model in models.items() for name in path.stem.split("-")}
