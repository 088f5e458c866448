"""Writes journals and recordings as MCAP, which Foxglove opens; needs the extra `mcap`."""

from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from typing import IO, Any

import msgspec
import numpy as np
from mcap.writer import Writer

from touchd.daemon.bridges.bridge import kind_of
from touchd.daemon.path.events import Event, RobotEvent, encode, epoch_s
from touchd.drivers.frame import COLUMNS, ROWS, Counts
from touchd.drivers.recording import Recording, realign, setup_of

NS_PER_MS = 1_000_000
# Gap between two recordings.
PAUSE_MS = 1000
# Foxglove's own definition; its image panel shows the pad.
RAW_IMAGE = {
    "title": "foxglove.RawImage",
    "type": "object",
    "properties": {
        "timestamp": {
            "type": "object",
            "title": "time",
            "properties": {"sec": {"type": "integer"}, "nsec": {"type": "integer"}},
        },
        "frame_id": {"type": "string"},
        "width": {"type": "integer"},
        "height": {"type": "integer"},
        "encoding": {"type": "string"},
        "step": {"type": "integer"},
        "data": {"type": "string", "contentEncoding": "base64"},
    },
}
LABEL = {
    "type": "object",
    "properties": {name: {"type": "string"} for name in ("participant", "substrate", "cover", "gesture")},
}


def write_events(events: Iterable[Event], file: IO[bytes]) -> None:
    """Write each event to /touchd/PAD/TYPE at its own time."""
    with _messages(file) as add:
        for event in events:
            of = "" if isinstance(event, RobotEvent) else f"/{event.pad}"
            name = type(event).__name__
            # Not every reader follows references, so write the definition itself.
            schema = msgspec.json.schema(type(event))["$defs"][name]
            time_ns = round(epoch_s(event.time) * 1e9)
            add(f"/touchd{of}/{kind_of(event)}", f"touchd.{name}", schema, time_ns, encode(event))


def write_recordings(recordings: Sequence[Recording], file: IO[bytes]) -> None:
    """Write frames to /touchd/pressure and labels to /touchd/recording, one recording after another."""
    with _messages(file) as add:
        start_ms = 0
        for recording in map(realign, recordings):
            steps = np.diff(recording.sensor_ms, prepend=recording.sensor_ms[0])
            # The clock jumps back when the pad restarts; time in the file must not.
            clock_ms = (np.cumsum(np.maximum(steps, 0)) + start_ms).tolist()
            label = dict(zip(LABEL["properties"], (*setup_of(recording), recording.gesture), strict=True))
            data = msgspec.json.encode(label)
            add("/touchd/recording", "touchd.Recording", LABEL, start_ms * NS_PER_MS, data)
            for ms, counts in zip(clock_ms, recording.counts, strict=True):
                data = msgspec.json.encode(_image(counts, ms))
                add("/touchd/pressure", "foxglove.RawImage", RAW_IMAGE, ms * NS_PER_MS, data)
            start_ms = clock_ms[-1] + PAUSE_MS


def _image(counts: Counts, ms: int) -> dict[str, Any]:
    return {
        "timestamp": {"sec": ms // 1000, "nsec": ms % 1000 * NS_PER_MS},
        "frame_id": "pad",
        "width": COLUMNS,
        "height": ROWS,
        "encoding": "mono16",
        "step": 2 * COLUMNS,
        # Encoded as base64.
        "data": counts.astype("<u2").tobytes(),
    }


@contextmanager
def _messages(file: IO[bytes]) -> Iterator[Callable[[str, str, dict[str, Any], int, bytes], None]]:
    """Yield a function that adds a JSON message: topic, name of the schema, schema, time in ns, data."""
    writer = Writer(file)
    channels: dict[str, int] = {}

    def add(topic: str, name: str, schema: dict[str, Any], time_ns: int, data: bytes) -> None:
        if topic not in channels:
            number = writer.register_schema(name, "jsonschema", msgspec.json.encode(schema))
            channels[topic] = writer.register_channel(topic, "json", number)
        writer.add_message(channels[topic], time_ns, data, time_ns)

    writer.start()
    try:
        yield add
    finally:
        writer.finish()  # type: ignore[no-untyped-call]
