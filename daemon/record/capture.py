"""Reads the pad during a recording and checks the result."""

import logging
import time
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from touchd.daemon.app.config import Settings
from touchd.daemon.path.monitor import TaxelFaults
from touchd.daemon.path.tracker import Onset, Release, TouchTracker
from touchd.daemon.record.session import Setting
from touchd.drivers.frame import CLOCK_MODULUS, FRAME_RATE_HZ, MIN_RATE_HZ, NO_TOUCH, Frame, SensorState
from touchd.drivers.pace import clock_ms, pace_of
from touchd.drivers.pad.grid import Ring
from touchd.drivers.pad.parser import FrameParser
from touchd.drivers.pad.port import check_port
from touchd.drivers.pad.sensor import FrameQueue, Sensor
from touchd.drivers.recording import Recording
from touchd.model.detector import Detector

SILENCE_S = 2.5
RESTARTED_MS = 1000
MOST_LOST_SHARE = 0.02
LEAST_TOUCHED_SHARE = 0.5
# A touch that ended is at most this old: the quiet that ends it comes on top of the time for a single one.
HISTORY_FRAMES = 1000
SINGLE_WITHIN_S, LONGEST_SINGLE_S = 8.0, 2.0
# Rest before a single touch that is kept.
LEAD_MS = 1000
NO_FRAME = "no frames arrive: is the pad plugged in and running?"


class PadLost(Exception):  # noqa: N818 - names what happened; the recording is repeated
    """The pad went away or restarted during a recording; the message is for the user."""


@dataclass(frozen=True, eq=False)
class Capture:
    """Recorded frames, and the share of them in which the pad was touched.

    touch: first and last contact of a gesture made once, by the pad's clock; None if there was none.
    """

    frames: tuple[Frame, ...]
    touched_share: float = 0.0
    touch: tuple[int, int] | None = None

    @property
    def length_s(self) -> float:
        return 0.0 if self.touch is None else (self.touch[1] - self.touch[0]) % CLOCK_MODULUS / 1000

    def recordings(self, setting: Setting, gesture: str) -> list[Recording]:
        """Return the frames on the pad's own clock.

        Of a gesture made once: the rest before, the touch, and the rest after, as the daemon saves a touch.
        """
        counts = np.stack([frame.pressure for frame in self.frames])
        clock = clock_ms(self.frames)
        parts = [(gesture, 0, len(clock))]
        if self.touch is not None:
            first_ms, last_ms = (clock[0] + (ms - clock[0]) % CLOCK_MODULUS for ms in self.touch)
            start, first, after = np.searchsorted(clock, (first_ms - LEAD_MS, first_ms, last_ms + 1))
            parts = [(NO_TOUCH, start, first), (gesture, first, after), (NO_TOUCH, after, len(clock))]
        return [
            Recording(*setting, name, counts[begin:stop], clock[begin:stop], "live")
            for name, begin, stop in parts
            if begin < stop
        ]


class PadReader:
    """Reads the pad during a session. A context manager; entering raises SensorError."""

    def __init__(self, settings: Settings) -> None:
        sensor = settings.sensor
        self._settings = settings
        self._queue = FrameQueue()
        self._sensor = Sensor(sensor.port, sensor.baud, FrameParser(sensor.described), self._queue)
        self._taxels = TaxelFaults()
        self._block: list[Frame] = []
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
        return list(self._taxels.found.values())

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
                    self._check_taxels(frame)
                    yield passed_ms / 1000, frame
                case SensorState() as state:
                    self._note(state)
                    if self._away:
                        raise PadLost(self._away)
                case None:
                    raise PadLost(self._away or NO_FRAME)

    def _check_taxels(self, frame: Frame) -> None:
        """Look for taxels that stand still, a second at a time."""
        self._block.append(frame)
        if len(self._block) > FRAME_RATE_HZ:
            self._taxels.update(self._block)
            self._block = [frame]

    def _note(self, item: Frame | SensorState | None) -> None:
        if isinstance(item, SensorState):
            self._away = item.reason if item.state == "down" else ""


class Contact:
    """Tracks whether the pad is touched; the first frames must show it at rest.

    touch: first and last contact of the first touch that ended, by the pad's clock.
    """

    def __init__(self, settings: Settings) -> None:
        self._ring = Ring(HISTORY_FRAMES)
        is_finer = settings.pipeline.is_finer
        self._tracker = TouchTracker(settings.touch, Detector.load(), is_finer=is_finer)
        self._touched, self._began_ms = False, 0
        self.touch: tuple[int, int] | None = None

    def update(self, frame: Frame) -> bool:
        """Process the next frame; return whether the pad is touched."""
        for laid in self._ring.push(frame):
            match self._tracker.update(laid):
                case Onset(first_index):
                    # By the end of a long touch, the ring has forgotten its beginning.
                    self._touched, self._began_ms = True, self._clock_at(first_index)
                case Release(last_index=last_index):
                    self._touched = False
                    if self.touch is None:
                        self.touch = self._began_ms, self._clock_at(last_index)
        return self._touched

    def _clock_at(self, index: int) -> int:
        (frame,) = self._ring.frames(index, index + 1)
        return round(frame.sensor_ms) % CLOCK_MODULUS


def complaints(capture: Capture, gesture: str, troubles: list[str], *, is_single: bool = False) -> list[str]:
    """Return reasons to repeat a recording, one line each; none if it is usable. is_single: made once."""
    if is_single:
        return [*troubles, *_complaints_about_single(capture)]
    pace = pace_of(capture.frames)
    if pace.rate_hz < MIN_RATE_HZ:
        return [
            *troubles,
            f"{pace.rate_hz:.1f} frames a second arrive; {MIN_RATE_HZ:.0f} or more are needed",
        ]
    found = list(troubles)
    if pace.lost > MOST_LOST_SHARE * len(capture.frames):
        found.append(f"{pace.lost} frames were lost: check cable and plug")
    if gesture == NO_TOUCH and capture.touched_share > 0:
        found.append("something touched the pad")
    elif gesture != NO_TOUCH and capture.touched_share == 0:
        found.append("no touch was detected: hands off during the countdown, then press a little harder")
    elif gesture != NO_TOUCH and capture.touched_share < LEAST_TOUCHED_SHARE:
        found.append(f"a touch was detected for only {capture.touched_share:.0%} of the time")
    return found


def _complaints_about_single(capture: Capture) -> list[str]:
    if capture.touch is None:
        return [f"no touch began and ended within {SINGLE_WITHIN_S:g} s"]
    if capture.length_s > LONGEST_SINGLE_S:
        return [f"that took {capture.length_s:.1f} s; once is enough"]
    return []
