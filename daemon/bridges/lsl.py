"""Streams markers and a pad's pressure over the Lab Streaming Layer, on the lab's common clock."""

import socket
import time
from collections.abc import Callable

import pylsl
from msgspec import UNSET

from touchd.daemon.bridges.bridge import kind_of
from touchd.daemon.path.events import Event, Prediction, epoch_s
from touchd.drivers.frame import COLUMNS, ROWS, Frame

READINGS = 10


class LslOutlet:
    """Pushes markers and frames with their own timestamps; listeners may come and go. name: of the robot."""

    def __init__(self, name: str, pad: str) -> None:
        self._stream = f"{name}-{pad}"
        # Both clocks are monotonic, so a frame's stamp is exact however late the frame is sent.
        self._ahead_s = _ahead_of(time.monotonic)
        self._markers = pylsl.StreamOutlet(self._info("markers", "Markers", 1, "string"))
        pressure = self._info("pressure", "Pressure", ROWS * COLUMNS, "float32")
        pressure.set_channel_labels([f"r{row}c{column}" for row in range(ROWS) for column in range(COLUMNS)])
        pressure.set_channel_units("counts")
        self._pressure = pylsl.StreamOutlet(pressure)

    def send_event(self, event: Event) -> None:
        self._markers.push_sample([marker_of(event)], epoch_s(event.time) + _ahead_of(time.time))

    def send_frame(self, frame: Frame) -> None:
        self._pressure.push_sample(frame.pressure.ravel().tolist(), frame.host_s + self._ahead_s)

    def _info(self, name: str, kind: str, channels: int, form: str) -> pylsl.StreamInfo:
        # Irregular: each sample has its own time. By its source_id an inlet finds the stream again after a
        # restart of touchd; another computer's stream must have another one.
        full = f"{self._stream}-{name}"
        source = f"{socket.gethostname()}-{full}"
        return pylsl.StreamInfo(full, kind, channels, pylsl.IRREGULAR_RATE, form, source_id=source)


def marker_of(event: Event) -> str:
    """Return an event as a short marker; MNE selects by the words between the slashes."""
    if isinstance(event, Prediction):
        words = [event.stage, event.gesture, "told" if event.told else "untold"]
    else:
        names = ("gesture", "state", "action")
        words = [kind_of(event), *(getattr(event, name) for name in names if hasattr(event, name))]
    tags = {} if event.tags is UNSET else event.tags
    return "/".join([*words, *(f"{key}={value}" for key, value in tags.items())])


def _ahead_of(clock: Callable[[], float]) -> float:
    """Return how far LSL's clock is ahead of `clock`, in seconds, by the quickest of some readings."""
    readings = ((clock(), float(pylsl.local_clock()), clock()) for _ in range(READINGS))
    return min((after - before, lsl - (before + after) / 2) for before, lsl, after in readings)[1]
