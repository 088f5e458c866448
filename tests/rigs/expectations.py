"""The shipped recordings, the streams beside them, and their expected events.

    make expectations              rebuilds the expected events
    make expectations RECORD=1     first makes again what is simulated
    make expectations ADD=FILE     first adds a recording as a stream

Read the diff before committing it: every changed line is a changed answer.
"""

import argparse
import inspect
import json
import logging
import shutil
import sys
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path

import numpy as np
from rigs.streams import STREAMS, Sent

from touchd.daemon.config import Settings
from touchd.daemon.events import Event, Prediction, SensorEvent, TouchBegan, TouchEnded
from touchd.daemon.parts import load_model
from touchd.daemon.pipeline import Clock, Pipeline
from touchd.daemon.playback.stream import DEMO_RECORDING as DEMO
from touchd.daemon.playback.stream import play
from touchd.drivers.fakes.hand import DEMO_SCRIPT, DEMO_SEED, simulate, write_simulated
from touchd.drivers.frame import CLOCK_MODULUS, Counts, Frame, SensorState
from touchd.drivers.recording import (
    Recording,
    Stream,
    read_recordings,
    splice,
    write_recordings,
)
from touchd.model.classifier import Classifier

FOLDER = Path(__file__).parents[1] / "recordings"
GAP_S = 1.8
# The reader reports the pad as down after this much silence, by the pad's clock here.
SILENCE_MS = 2000
# Steps of the clock beyond this are not time that passes.
LONGEST_STEP_MS = 60_000
OUTLINE: Mapping[type, tuple[str, ...]] = {
    TouchBegan: ("touch",),
    Prediction: ("touch", "stage", "gesture", "changed", "told", "degraded"),
    TouchEnded: ("touch", "gesture", "reason"),
}

Script = Sequence[tuple[str, float]]


def _with_gaps(touches: Script) -> Script:
    script = [("notouch", 2.5)]
    for touch in touches:
        script += [touch, ("notouch", GAP_S)]
    return script


GESTURES, LENGTHS = FOLDER / "gestures.csv.gz", FOLDER / "lengths.csv.gz"
# Touches that end in each stage, and one in which a resting hand starts to pat.
TOUCH_LENGTHS = [("stroke", 0.4), ("pat", 0.8), ("scratch", 1.2), ("tickle", 1.8), ("rub", 2.9)]
TOUCH_GESTURES = [(gesture, 3.2) for gesture in ("constant", "tickle", "scratch", "rub", "stroke", "pat")]
RECORDINGS: dict[Path, tuple[Script, int]] = {
    DEMO: (DEMO_SCRIPT, DEMO_SEED),
    GESTURES: (_with_gaps(TOUCH_GESTURES), 11),
    LENGTHS: ([*_with_gaps(TOUCH_LENGTHS), ("constant", 3.6), ("pat", 4.0), ("notouch", GAP_S)], 12),
}


def expectation_of(recording: Path) -> Path:
    """Return the file with the expected events of a recording."""
    return FOLDER / f"{recording.name.removesuffix('.csv.gz')}.expected.jsonl"


def stream_of(recording: Path) -> Stream:
    """Return a shipped recording as the stream of a pad."""
    return splice(read_recordings(recording))


def beginning_of(recording: Path, touches: int) -> Stream:
    """Return the first touches of a shipped recording, with the rest after the last."""
    whole = stream_of(recording)
    stop = whole.spans[2 * touches].stop
    return Stream(whole.counts[:stop], whole.sensor_ms[:stop], whole.spans[: 2 * touches + 1])


def expected(recording: Path) -> list[dict[str, object]]:
    """Return the expected events of a recording."""
    return [json.loads(line) for line in expectation_of(recording).read_text().splitlines()]


def outline(events: Iterable[Event]) -> list[dict[str, object]]:
    """Return touches and answers without what differs between playbacks of the same stream."""
    return [
        {"type": event.__struct_config__.tag, **{name: getattr(event, name) for name in OUTLINE[type(event)]}}
        for event in events
        if type(event) in OUTLINE
    ]


def answers(stream: Stream, classifier: Classifier) -> list[Event]:
    """Return the pipeline's events for a stream, without a port."""
    events: list[Event] = []
    play(stream, Pipeline(Settings().pipeline, classifier, events.append))
    return events


def streams() -> list[Path]:
    """Return the streams beside the shipped recordings: each a fault, a pad or a kind of touch."""
    return sorted(path for path in FOLDER.glob("*.csv.gz") if path not in RECORDINGS)


def told_of(path: Path, classifier: Classifier) -> list[dict[str, object]]:
    """Return what the pipeline tells of a stream as its frames come: events, the pad's states, warnings."""
    told: list[dict[str, object]] = []

    def put(event: Event) -> None:
        if isinstance(event, SensorEvent):
            told.append({"type": "sensor", "state": event.state, "reason": event.reason})
        told.extend(outline([event]))

    now_s = 0.0
    pipeline = Pipeline(Settings().pipeline, classifier, put, Clock(monotonic_s=lambda: now_s))
    with _Warnings(told):
        before_ms: int | None = None
        for number, (ms, counts) in enumerate(_frames(path)):
            step_ms = 0 if before_ms is None else (ms - before_ms) % CLOCK_MODULUS
            now_s += (step_ms if step_ms <= LONGEST_STEP_MS else 0) / 1000
            if before_ms is None or SILENCE_MS < step_ms <= LONGEST_STEP_MS:
                if before_ms is not None:
                    pipeline.on_sensor_state(SensorState("down", "no data for 2 s", "silent"))
                pipeline.on_sensor_state(SensorState("up", "frames arrive"))
            pipeline.on_frame(Frame(number, ms, now_s, counts))
            before_ms = ms
        pipeline.flush()
    return told


class _Warnings(logging.Handler):
    """Adds the warnings logged in a context to a list."""

    def __init__(self, told: list[dict[str, object]]) -> None:
        super().__init__(logging.WARNING)
        self._told = told

    def emit(self, record: logging.LogRecord) -> None:
        self._told.append({"type": "log", "line": record.getMessage()})

    def __enter__(self) -> None:
        logging.getLogger("touchd").addHandler(self)

    def __exit__(self, *_: object) -> None:
        logging.getLogger("touchd").removeHandler(self)


def _frames(path: Path) -> Iterable[tuple[int, Counts]]:
    """Yield a stream's clock and counts as the file holds them."""
    for recording in read_recordings(path):
        yield from zip(recording.sensor_ms.tolist(), recording.counts.astype(np.uint16), strict=True)


def make_stream(name: str) -> None:
    """Write a made-up stream, unless the file holds the same already."""
    path, made = FOLDER / f"{name}.csv.gz", STREAMS[name]()
    if not holds(path, made):
        path.unlink(missing_ok=True)
        source = {
            "title": inspect.getdoc(STREAMS[name]) or name,
            "source": "SIMULATED by tests/rigs/streams.py; no person's data",
            "licence": "Apache-2.0",
        }
        write_recordings(path, [Recording("simulated", "none", "none", "stream", *made, "live")], source)
        path.chmod(0o644)


def holds(path: Path, made: Sent) -> bool:
    """Whether a file holds these frames already: packed again, it would have other bytes."""
    if not path.exists():
        return False
    clock_ms, counts = zip(*_frames(path), strict=True)
    return np.array_equal(np.stack(counts), made.counts) and list(clock_ms) == made.sensor_ms.tolist()


def add_stream(path: Path) -> Path:
    """Copy a recording among the streams, with a name of its own; raises SystemExit if that is taken."""
    read_recordings(path)
    new = FOLDER / path.name
    if new.exists():
        raise SystemExit(f"{new}: is there already; rename {path}")
    shutil.copyfile(path, new)
    return new


def rebuild() -> None:
    """Write the expected events of every recording and stream."""
    classifier = load_model(Settings())
    told = {path: outline(answers(stream_of(path), classifier)) for path in RECORDINGS}
    told |= {path: told_of(path, classifier) for path in streams()}
    for path, events in told.items():
        expectation_of(path).write_text("".join(f"{json.dumps(event)}\n" for event in events))


def main(arguments: Sequence[str]) -> None:
    """Rebuild the expected events, if asked after making or adding recordings."""
    parser = argparse.ArgumentParser(description=main.__doc__)
    parser.add_argument("--record", action="store_true", help="make what is simulated again")
    parser.add_argument("--add", type=Path, metavar="FILE", help="a recording (.csv.gz) to add as a stream")
    options = parser.parse_args(arguments)
    if options.record:
        for path, (script, seed) in RECORDINGS.items():
            parts = simulate(script, seed)
            counts = np.concatenate([part.counts for part in parts])
            if not holds(path, Sent(counts, np.concatenate([part.sensor_ms for part in parts]))):
                path.unlink(missing_ok=True)
                write_simulated(path, script, seed)
        for name in STREAMS:
            make_stream(name)
    if options.add:
        add_stream(options.add)
    rebuild()


if __name__ == "__main__":
    main(sys.argv[1:])
