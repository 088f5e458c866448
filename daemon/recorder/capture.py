"""Reads the pad during a recording and checks the result."""

import logging
import time
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from touchd.daemon.config import Settings
from touchd.daemon.monitor import TaxelFaults
from touchd.daemon.recorder.who import Setting
from touchd.daemon.tracker.tracker import Onset, Release, TouchTracker
from touchd.drivers.frame import CLOCK_MODULUS, NO_TOUCH, Frame, SensorState
from touchd.drivers.pad.grid import MAX_GAP_S, Ring
from touchd.drivers.pad.pace import clock_ms, pace_of
from touchd.drivers.pad.port import check_port
from touchd.drivers.pad.protocol import parser_of
from touchd.drivers.pad.sensor import FrameQueue, Sensor
from touchd.drivers.recording import Recording

SILENCE_S = 2.5
RESTARTED_MS = 1000
MOST_LOST_SHARE = 0.02
LEAST_TOUCHED_SHARE = 0.5
LEAST_RATE_HZ = 1.0 / MAX_GAP_S
NO_FRAME = "no frames arrive: is the pad plugged in and running?"


class PadLost(Exception):  # noqa: N818 - names what happened; the recording is repeated
    """The pad went away or restarted during a recording; the message is for the user."""


@dataclass(frozen=True, eq=False)
class Capture:
    """Recorded frames, and the share of them in which the pad was touched."""

    frames: tuple[Frame, ...]
    touched_share: float

    def recording(self, setting: Setting, gesture: str) -> Recording:
        """Return the frames as a recording, on the pad's own clock."""
        counts = np.stack([frame.pressure for frame in self.frames])
        return Recording(*setting, gesture, counts, clock_ms(self.frames), "live")


class PadReader:
    """Reads the pad during a session. A context manager; entering raises SensorError."""

    def __init__(self, settings: Settings) -> None:
        sensor = settings.sensor
        self._settings = settings
        self._queue = FrameQueue()
        self._sensor = Sensor(sensor.port, sensor.baud, parser_of(sensor.described), self._queue)
        self._taxels = TaxelFaults()
        self._away = ""

    def __enter__(self) -> "PadReader":
        check_port(self._settings.sensor.port, self._settings.sensor.baud)
        # Log lines would break the progress bar; the dialogue shows the sensor's faults itself.
        logging.getLogger("touchd.drivers").addHandler(logging.NullHandler())
        self._sensor.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._sensor.stop()

    @property
    def troubles(self) -> list[str]:
        """Current faults of taxels, in words."""
        return list(self._taxels.faults.values())

    def await_frame(self, within_s: float) -> str:
        """Drop queued frames and wait for a new one; return why none arrived, "" if one did."""
        for _ in range(len(self._queue)):
            self._note(self._queue.get(timeout_s=0))
        until_s = time.monotonic() + within_s
        while (left_s := until_s - time.monotonic()) > 0:
            item = self._queue.get(timeout_s=left_s)
            self._note(item)
            if isinstance(item, Frame):
                return ""
        return self._away or NO_FRAME

    def follow(self, seconds: float) -> Iterator[tuple[float, Frame]]:
        """Yield (seconds since the first frame, frame) for a number of seconds on the pad's clock.

        Raises PadLost if the pad goes away or restarts.
        """
        passed_ms = 0
        last: Frame | None = None
        while passed_ms < 1000 * seconds:
            match self._queue.get(timeout_s=SILENCE_S):
                case Frame() as frame:
                    step_ms = (frame.sensor_ms - last.sensor_ms) % CLOCK_MODULUS if last else 0
                    if step_ms > RESTARTED_MS:
                        raise PadLost("the pad restarted or was disconnected: check its plug")
                    passed_ms += step_ms
                    last = frame
                    self._taxels.update(frame)
                    yield passed_ms / 1000, frame
                case SensorState() as state:
                    self._note(state)
                    if self._away:
                        raise PadLost(self._away)
                case None:
                    raise PadLost(self._away or NO_FRAME)

    def _note(self, item: Frame | SensorState | None) -> None:
        if isinstance(item, SensorState):
            self._away = item.reason if item.state == "down" else ""


class Contact:
    """Tracks whether the pad is touched; the first frames must show it at rest."""

    def __init__(self, settings: Settings) -> None:
        self._ring = Ring(1)
        self._tracker = TouchTracker(settings.touch)
        self._touched = False

    def update(self, frame: Frame) -> bool:
        """Process the next frame; return whether the pad is touched."""
        for laid in self._ring.push(frame):
            match self._tracker.update(laid):
                case Onset():
                    self._touched = True
                case Release():
                    self._touched = False
        return self._touched


def complaints(capture: Capture, gesture: str, troubles: list[str]) -> list[str]:
    """Return reasons to repeat a recording, one line each; none if it is usable."""
    found = list(troubles)
    pace = pace_of(capture.frames)
    if pace.rate_hz < LEAST_RATE_HZ:
        found.append(f"{pace.rate_hz:.1f} frames a second arrive; more than {LEAST_RATE_HZ:.0f} are needed")
        return found
    if pace.lost > MOST_LOST_SHARE * len(capture.frames):
        found.append(f"{pace.lost} frames were lost: check cable and plug")
    if gesture == NO_TOUCH and capture.touched_share > 0:
        found.append("something touched the pad")
    elif gesture != NO_TOUCH and capture.touched_share == 0:
        found.append("no touch was detected: hands off during the countdown, then press a little harder")
    elif gesture != NO_TOUCH and capture.touched_share < LEAST_TOUCHED_SHARE:
        found.append(f"a touch was detected for only {capture.touched_share:.0%} of the time")
    return found
