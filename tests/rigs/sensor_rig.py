"""A sensor on a fake port, for the tests of the sensor."""

import os
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

import numpy as np
from rigs.formats import FabricGrid, encode_fabric_grid
from rigs.wait import AT_ONCE_S, WITHIN_S, wait_for

from touchd.daemon.path.monitor import PadMonitor
from touchd.drivers.frame import Counts, Frame, SensorState
from touchd.drivers.pad.parser import FrameParser
from touchd.drivers.pad.sensor import FrameQueue, Sensor
from touchd.drivers.recording import Span, Stream, ideal_clock_ms

BAUD = 512000
Encode = Callable[[Counts, int], bytes]


def stream_of(frames: int = 4000) -> Stream:
    counts = np.random.default_rng(2).integers(0, 1024, (frames, 8, 8)).astype(np.uint16)
    return Stream(counts, ideal_clock_ms(frames, 1000), (Span(0, frames, "rub"),))


class MonitoredQueue(FrameQueue):
    """Logs the reader's reports as the daemon does, and queues a state only if it changes."""

    def __init__(self) -> None:
        super().__init__(100_000)
        self._monitor = PadMonitor()

    def put(self, item: Frame | SensorState) -> None:
        if isinstance(item, Frame) or self._monitor.on_sensor(item):
            super().put(item)


@contextmanager
def sensing(
    port: str,
    protocol: FrameParser | None = None,
    **options: float,
) -> Iterator[FrameQueue]:
    """Yield a running sensor's queue; afterwards no thread or descriptor of it is left."""
    before = len(os.listdir("/proc/self/fd"))
    queue = MonitoredQueue()
    pauses_s = {"longest_retry_s": 0.2, "silence_s": 0.5} | options
    sensor = Sensor(port, BAUD, protocol or FabricGrid(), queue)
    for name, pause_s in pauses_s.items():
        assert hasattr(sensor, name)
        setattr(sensor, name, pause_s)
    sensor.start()
    try:
        yield queue
    finally:
        begun_s = time.monotonic()
        sensor.stop()
        sensor.stop()
        assert time.monotonic() - begun_s < AT_ONCE_S
        assert "touchd-sensor" not in [thread.name for thread in threading.enumerate()]
        # The fake port opens its own line for a moment, repeatedly, until everything has been read.
        wait_for(lambda: len(os.listdir("/proc/self/fd")) <= before, AT_ONCE_S)


def next_frames(queue: FrameQueue, count: int) -> list[Frame]:
    frames: list[Frame] = []
    while len(frames) < count:
        item = queue.get(WITHIN_S)
        assert item is not None, f"only {len(frames)} of {count} frames came"
        if isinstance(item, Frame):
            frames.append(item)
    return frames


def next_state(queue: FrameQueue) -> SensorState:
    while not isinstance(item := queue.get(WITHIN_S), SensorState):
        assert item is not None, "no state was told"
    return item


def assert_played(frames: list[Frame], stream: Stream, indices: range | list[int]) -> None:
    assert [frame.sensor_ms for frame in frames] == stream.sensor_ms[indices].tolist()
    for frame, index in zip(frames, indices, strict=True):
        np.testing.assert_array_equal(frame.pressure, stream.counts[index])


class Switch:
    """An encoding that a test can change while it plays."""

    def __init__(self, encode: Encode) -> None:
        self.encode = encode

    def __call__(self, counts: Counts, sensor_ms: int) -> bytes:
        return self.encode(counts, sensor_ms)


def silence(counts: Counts, sensor_ms: int) -> bytes:
    return b""


def noise(counts: Counts, sensor_ms: int) -> bytes:
    return np.random.default_rng(sensor_ms).bytes(200)


def as_8x8(counts: Counts, sensor_ms: int) -> bytes:
    return encode_fabric_grid(counts, sensor_ms, rows=8, columns=8, crop=0)
