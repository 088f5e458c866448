"""Reads the pad during a recording and checks the result."""

import logging
from collections.abc import Iterable, Iterator
from dataclasses import dataclass

import numpy as np

from touchd.daemon.app.config import Settings
from touchd.daemon.path.monitor import TaxelFaults
from touchd.daemon.path.pipeline import PipelineSettings, tracker_of
from touchd.daemon.path.tracker import Onset, Release
from touchd.daemon.record.session import Setting, Take
from touchd.daemon.sinks.touch_store import around_touch
from touchd.drivers.frame import CLOCK_MODULUS, FRAME_RATE_HZ, MIN_RATE_HZ, NO_TOUCH, Frame, SensorState
from touchd.drivers.pace import clock_ms, pace_of
from touchd.drivers.pad.grid import Ring
from touchd.drivers.pad.parser import FrameParser
from touchd.drivers.pad.port import SensorError, check_port
from touchd.drivers.pad.sensor import FrameQueue, Sensor
from touchd.drivers.recording import Recording
from touchd.model.classifier import Classifier
from touchd.model.detector import Detector

# Opening the port may restart the board, which takes two seconds.
SILENCE_S = 4.0
RESTARTED_MS = 1000
MOST_LOST_SHARE = 0.02
LEAST_TOUCHED_SHARE = 0.5
SINGLE_WITHIN_S, LONGEST_SINGLE_S = 8.0, 2.0


class PadLost(Exception):  # noqa: N818 - names what happened; the recording is repeated
    """The pad went away or restarted during a recording; the message is for the user."""


@dataclass(frozen=True, eq=False)
class Capture:
    """Recorded frames, and the share of them in which the pad was touched.

    touch: first and last contact of a gesture made once, by the pad's clock; None if none was detected.
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
        if self.touch is not None:
            return around_touch(self.frames, self.touch, setting, gesture)
        counts = np.stack([frame.pressure for frame in self.frames])
        return [Recording(*setting, gesture, counts, clock_ms(self.frames), "live")]


class PadReader:
    """Reads the pad during a session. A context manager; entering raises SensorError.

    model: asked by the tracker in doubt, as in the daemon.
    """

    def __init__(self, settings: Settings, model: Classifier) -> None:
        sensor = settings.sensor
        self.settings = settings
        self._model = model
        self._queue = FrameQueue()
        self._sensor = Sensor(sensor.port, sensor.baud, FrameParser(sensor.described), self._queue)
        self.taxels = TaxelFaults()
        self._block: list[Frame] = []
        self._away = ""

    def __enter__(self) -> "PadReader":
        try:
            check_port(self.settings.sensor.port, self.settings.sensor.baud)
        except SensorError as error:
            raise SensorError(error.kind, f"{error}; touchd doctor says more") from error
        # Log lines would break the progress bar; the dialogue shows the sensor's faults itself.
        logging.getLogger("touchd.drivers").addHandler(logging.NullHandler())
        self._sensor.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._sensor.stop()

    def contact(self) -> "Contact":
        """Return what detects touches in the frames from now on; drop queued frames."""
        for item in self._queue.take_all():
            self._note(item)
        return Contact(self.settings.pipeline, self._model)

    def follow(self, seconds: float) -> Iterator[tuple[float, Frame]]:
        """Yield (seconds since the first frame, frame) for a number of seconds by the pad's clock.

        Raises PadLost if no frame arrives, or the pad goes away or restarts.
        """
        passed_ms = 0
        last: Frame | None = None
        while passed_ms < 1000 * seconds:
            item = self._queue.get(timeout_s=SILENCE_S)
            self._note(item)
            if isinstance(item, Frame):
                step_ms = (item.sensor_ms - last.sensor_ms) % CLOCK_MODULUS if last else 0
                if step_ms > RESTARTED_MS:
                    raise PadLost("the pad restarted or was disconnected: check its plug")
                passed_ms += step_ms
                last = item
                self._check_taxels(item)
                yield passed_ms / 1000, item
            elif item is None or self._away:
                raise PadLost(self._away or "no frames arrive: is the pad plugged in and running?")

    def _check_taxels(self, frame: Frame) -> None:
        """Check for taxels that stand still, once a second."""
        self._block.append(frame)
        if len(self._block) > FRAME_RATE_HZ:
            self.taxels.update(self._block)
            self._block = [frame]

    def _note(self, item: Frame | SensorState | None) -> None:
        if isinstance(item, SensorState):
            self._away = item.reason if item.state == "down" else ""


class Contact:
    """Tracks whether the pad is touched, as the daemon does; the first frames must show it at rest.

    is_touched: now. touch: first and last contact of the first touch that ended, by the pad's clock.
    """

    def __init__(self, settings: PipelineSettings, model: Classifier) -> None:
        self._ring = Ring(1)
        self._tracker = tracker_of(settings, model, Detector.load())
        self._clock_ms: list[int] = []
        self.is_touched = False
        self.touch: tuple[int, int] | None = None

    def update(self, frame: Frame) -> None:
        """Process the next frame."""
        for laid in self._ring.push(frame):
            self._clock_ms.append(round(laid.sensor_ms) % CLOCK_MODULUS)
            match self._tracker.update(laid):
                case Onset():
                    self.is_touched = True
                case Release(first, last):
                    self.is_touched = False
                    self.touch = self.touch or (self._clock_ms[first], self._clock_ms[last])


def complaints(capture: Capture, take: Take, troubles: Iterable[str]) -> list[str]:
    """Return reasons to repeat a recording, one line each; none if it is usable. troubles: of taxels."""
    found = list(troubles)
    if take.is_single:
        if capture.touch is None:
            found.append(f"no touch began and ended within {SINGLE_WITHIN_S:g} s")
        elif capture.length_s > LONGEST_SINGLE_S:
            found.append(f"that took {capture.length_s:.1f} s; once is enough")
        return found
    pace, is_touch = pace_of(capture.frames), take.gesture != NO_TOUCH
    if pace.rate_hz < MIN_RATE_HZ:
        return [*found, f"{pace.rate_hz:.1f} frames a second arrive; {MIN_RATE_HZ:.0f} or more are needed"]
    if pace.lost > MOST_LOST_SHARE * len(capture.frames):
        found.append(f"{pace.lost} frames were lost: check cable and plug")
    if not is_touch and capture.touched_share > 0:
        found.append("something touched the pad")
    elif is_touch and capture.touched_share == 0:
        found.append("no touch was detected: hands off during the countdown, then press a little harder")
    elif is_touch and capture.touched_share < LEAST_TOUCHED_SHARE:
        found.append(f"a touch was detected for only {capture.touched_share:.0%} of the time")
    return found
