"""The shipped recordings and their expected events, which `rigs.pairs` writes."""

import json
from collections.abc import Iterable, Mapping
from pathlib import Path

from touchd.daemon.app.config import Settings
from touchd.daemon.path.events import Event, Prediction, TouchBegan, TouchEnded
from touchd.daemon.path.pipeline import Pipeline
from touchd.daemon.playback.stream import DEMO_RECORDING as DEMO
from touchd.daemon.playback.stream import play
from touchd.drivers.recording import Stream, read_recordings, splice
from touchd.model.classifier import Classifier

FOLDER = Path(__file__).parents[1] / "recordings"
OUTLINE: Mapping[type, tuple[str, ...]] = {
    TouchBegan: ("touch",),
    Prediction: ("touch", "stage", "gesture", "changed", "told", "degraded"),
    TouchEnded: ("touch", "gesture", "reason"),
}

GESTURES, LENGTHS = FOLDER / "gestures.csv.gz", FOLDER / "lengths.csv.gz"
RECORDINGS = (DEMO, GESTURES, LENGTHS)


def expectation_of(recording: Path) -> Path:
    """Return the file with the expected events of a recording."""
    return FOLDER / f"{recording.name.partition('.')[0]}.expected.jsonl"


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
    play(stream, lambda clock: Pipeline(Settings().pipeline, classifier, events.append, clock))
    return events
