"""Monitors a pad: decides on its state (up, degraded, down) and logs its faults, at a limited rate.

Faults are seen in four places: by the reader (no frames), in the frames' clock and gaps, in what the parser
refuses, and in the values at rest (broken wires, a short, noise). Here they become one state and one log.
"""

import logging
import math
from collections import deque
from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from touchd.daemon.path.tracker.baseline import TAXELS
from touchd.daemon.path.tracker.tracker import CALIBRATION_FRAMES, CHECK_FRAMES
from touchd.drivers.faults import FaultLog
from touchd.drivers.frame import (
    CLOCK_MODULUS,
    COLUMNS,
    DEFAULT_PAD,
    FRAME_RATE_HZ,
    MIN_RATE_HZ,
    ROWS,
    Counts,
    Frame,
    SensorState,
)
from touchd.drivers.pad.parser import FrameParser

log = logging.getLogger(__name__)

# Interval at which lasting faults are noted again, by the frames' arrival.
NOTE_S = 1.0
# Faults that prevent detection, of light touches at least; others cost a part of the pad or some frames.
DEGRADING = ("gaps", "restarts", "frozen", "garbled", "noise")

# A fault is reported once it has lasted for this time, since the taxels of one broken wire do not fall still
# at once. After a longer pause in their arrival, frames prove nothing: the daemon may have been suspended.
LASTS_S = 2.0

# Interval at which the parser's counts are compared. One lost frame in fifty is a fault that will grow.
COMPARE_S = 10.0
MANY_SHARE = 0.02

MINUTE_S = 60.0
# A pad that restarts this often in a minute is degraded.
OFTEN_RESTARTS = 3
# Values that jump, on a pad too slow to tell them from a pat, keep a touch open; so does a load that moves.
LONG_TOUCH = "a touch has gone on for a minute; if no hand is there, what lies on the pad, or do values jump?"

# Rest is checked six times a second. The noise measured while a hand leaves is too high, and falls within
# three seconds; a pad counts as noisy after five.
NOISY_CHECKS = round(5 * FRAME_RATE_HZ / CHECK_FRAMES)

# Frames are checked half a second at a time, which takes a twentieth of the time of one by one.
BLOCK_MS = 500
# The share of frames, averaged over LASTS_S, in which a taxel changes: mostly above one half on a sound pad.
# If a taxel stops changing, it counts as still after about 8 s, and as lively half a second after it moves.
STILL_SHARE = 0.01
LIVELY_SHARE = 0.1
# On a pad with noise, a taxel that stands still is broken. A pad has noise if three quarters of its taxels
# change in this share of the first frames without a hand, as on HAART's and the robot's pads.
NOISY_SHARE = 0.3
SATURATED_COUNT = 1000
# A frame is garbled if a taxel that reads more, or less, than in the frames before and after does so by this
# many counts; smaller jumps are noise. On a pad of less than 40 Hz a pat looks the same.
JUMP_COUNTS, GARBLED_SHARE, GARBLED_HZ = 100, 0.35, 40.0


class PadMonitor:
    """Follows a pad's frames and states; each method returns the pad's state if it has changed.

    name: the pad's, for the log. parser: its counts show damage on the line. where: the pad's port.
    """

    def __init__(self, name: str = DEFAULT_PAD, parser: FrameParser | None = None, where: str = "") -> None:
        self._prefix = "" if name == DEFAULT_PAD else f"{name}: "
        self._faults = FaultLog(log, self._prefix)
        self._gaps = _Gaps()
        self._taxels = TaxelFaults()
        self._line = None if parser is None else _LineFaults(parser, where)
        self._rest = _Rest()
        self._lasting: dict[str, str] = {}
        self._noted_s = -math.inf
        self._state: SensorState | None = None

    def on_sensor(self, state: SensorState) -> SensorState | None:
        """Take what the reader reports: that frames come, or after each attempt that none do."""
        advice = "leave the pad alone for half a second, while its rest is measured"
        if state.state == "down":
            if not self._faults.begin("down", state.reason, cause=state.cause):
                return None
            self._gaps, self._rest = _Gaps(), _Rest()
            for kind in ("gaps", "noise", "loose wire"):
                self._faults.end(kind)
                self._lasting.pop(kind, None)
        elif self._state is None:
            log.info("%s%s; %s", self._prefix, state.reason, advice)
        else:
            self._faults.end("down", f"{state.reason} again; {advice}")
        self._state = state
        return state

    def on_frame(
        self, frame: Frame, *, restarted: bool, is_untouched: bool = True, touched_s: float = 0.0
    ) -> SensorState | None:
        """Take the next frame. restarted: whether the grid restarted with it.

        is_untouched: by any hand. touched_s: how long the touch has gone on, if there is one.
        """
        self._gaps.update(frame, restarted)
        self._taxels.update(frame, is_untouched=is_untouched)
        if self._line is not None:
            self._line.update(frame.host_s)
        return self._note(frame.host_s, touched_s)

    def on_rest(self, *, is_noisy: bool, loose_lines: Sequence[str]) -> None:
        """Take what the tracker knows of the untouched pad, every CHECK_FRAMES while nothing touches it."""
        self._rest.update(is_noisy, loose_lines)

    def _note(self, now_s: float, touched_s: float) -> SensorState | None:
        """Log what has begun and ended; return the state if it is another one now."""
        found = self._gaps.faults | self._taxels.faults | self._rest.faults
        if touched_s >= MINUTE_S:
            found["long touch"] = LONG_TOUCH
        if "loose wire" in found:
            # It is the line that jumps.
            found.pop("garbled", None)
        if self._line is not None:
            found |= self._line.faults
        if found.keys() == self._lasting.keys() and now_s - self._noted_s < NOTE_S:
            return None
        self._noted_s = now_s
        for kind in self._lasting.keys() - found.keys():
            self._faults.end(kind, f"no longer: {self._lasting[kind]}", now_s)
        for kind, what in found.items():
            self._faults.begin(kind, what, now_s, cause=what)
        self._lasting = found
        worst = next((kind for kind in DEGRADING if kind in found), "")
        before = self._state.cause if self._state is not None and self._state.state == "degraded" else ""
        if worst == before:
            return None
        self._state = SensorState("up", "touches are recognised again")
        if worst:
            self._state = SensorState("degraded", found[worst], worst)
        return self._state


class _Gaps:
    """Whether frames come close enough together, by the pad's clock, for rest to be measured."""

    def __init__(self) -> None:
        self.faults: dict[str, str] = {}
        self._frames: deque[Frame] = deque(maxlen=CALIBRATION_FRAMES)
        self._without_gap = 0
        self._since_s = -math.inf

    def update(self, frame: Frame, restarted: bool) -> None:
        is_first = not self._frames or frame.host_s - self._frames[-1].host_s > LASTS_S
        self._frames.append(frame)
        self._without_gap = 0 if restarted else self._without_gap + 1
        if is_first:
            self._since_s = frame.host_s
        if self._without_gap >= CALIBRATION_FRAMES:
            self._since_s = frame.host_s
            took_ms = (frame.sensor_ms - self._frames[0].sensor_ms) % CLOCK_MODULUS
            rate_hz = 1000 * (CALIBRATION_FRAMES - 1) / took_ms if took_ms else FRAME_RATE_HZ
            if rate_hz >= MIN_RATE_HZ - 0.5:
                self.faults.clear()
            else:
                self.faults["gaps"] = _too_slow(rate_hz)
        elif not self.faults and restarted and frame.host_s - self._since_s >= LASTS_S:
            self.faults["gaps"] = f"no touch is recognised: {self._why()}"

    def _why(self) -> str:
        first, last = self._frames[0], self._frames[-1]
        # Frames that were read together have the same arrival time.
        rate_hz = (len(self._frames) - 1) / max(last.host_s - first.host_s, 0.001)
        steps_ms = [(b.sensor_ms - a.sensor_ms) % CLOCK_MODULUS for a, b in pairwise(self._frames)]
        if max(steps_ms) > CLOCK_MODULUS // 2:
            return (
                "the pad's clock goes back and forth; do frames overtake one another on the way, or do two "
                "boards send there?"
            )
        if rate_hz >= MIN_RATE_HZ:
            return (
                f"{rate_hz:.0f} frames a second come, with gaps of up to {max(steps_ms)} ms; are frames lost "
                "on the way?"
            )
        return _too_slow(rate_hz)


def _too_slow(rate_hz: float) -> str:
    return (
        f"{rate_hz:.1f} frames a second come, and {MIN_RATE_HZ:.0f} or more are needed, best "
        f"{FRAME_RATE_HZ:.0f}"
    )


class _LineFaults:
    """Whether a parser refuses more than a few frames or skips the clock, and the pad often restarts."""

    def __init__(self, parser: FrameParser, where: str) -> None:
        self.faults: dict[str, str] = {}
        self._parser = parser
        self._where = where
        self._before = replace(parser.counts)
        self._compared_s = -math.inf
        self._restarts = parser.counts.restarts
        self._restarts_s: deque[float] = deque(maxlen=OFTEN_RESTARTS)

    def update(self, now_s: float) -> None:
        """Compare the counts every COMPARE_S of arrival; look at the clock and for restarts each time."""
        if self._parser.counts.restarts != self._restarts:
            self._restarts = self._parser.counts.restarts
            self._restarts_s.append(now_s)
        is_often = len(self._restarts_s) == OFTEN_RESTARTS and now_s - self._restarts_s[0] <= MINUTE_S
        often = (
            f"the pad restarted {OFTEN_RESTARTS} times in a minute, which may cut touches; is its supply too "
            "weak, or does its firmware crash?"
        )
        self._note("restarts", often if is_often else "")
        passed_s = now_s - self._compared_s
        if passed_s < COMPARE_S:
            return
        counts, before = replace(self._parser.counts), self._before
        self._before, self._compared_s = counts, now_s
        if passed_s > 2 * COMPARE_S:
            # The first frames, or those after a pause, which is reported elsewhere.
            return
        intact, refused = counts.frames - before.frames, counts.bad - before.bad
        share = refused / max(intact + refused, 1)
        # What the board prints when it crashes and starts is not damage.
        is_damaged = intact and share > MANY_SHARE and counts.restarts == before.restarts
        advice = "try a shorter cable and another USB port, no hub; does another program read it too (fuser)?"
        if "://" in self._where:
            advice = "does another board send there too?"
        damaged = f"{share:.0%} of the last frames were damaged on the way; {advice}"
        self._note("line", damaged if is_damaged else "")
        above = f"values above full_scale {self._parser.format.full_scale} are cut to it"
        clipped = f"{above}; if firm presses do that, set a larger one in sensor.format"
        self._note("full scale", clipped if counts.clipped - before.clipped > MANY_SHARE * intact else "")

    def _note(self, kind: str, what: str) -> None:
        """Note a fault, or that there is none of this kind."""
        if what:
            self.faults[kind] = f"{self._where}: {what}"
        else:
            self.faults.pop(kind, None)


class _Rest:
    """Whether the untouched pad is too noisy for light touches, and which of its lines jump."""

    def __init__(self) -> None:
        self.faults: dict[str, str] = {}
        self._other_checks = 0

    def update(self, is_noisy: bool, loose_lines: Sequence[str]) -> None:
        self._other_checks = self._other_checks + 1 if is_noisy != ("noise" in self.faults) else 0
        if self._other_checks >= NOISY_CHECKS:
            self._other_checks = 0
            if is_noisy:
                self.faults["noise"] = (
                    "light touches are not recognised: the pad is noisy though nobody touches it; a motor, "
                    "mains hum, a loose wire?"
                )
            else:
                del self.faults["noise"]
        if loose_lines:
            self.faults["loose wire"] = (
                f"the values of {', '.join(loose_lines)} jump while nobody touches the pad: a loose wire? "
                "The jumps are taken out"
            )


class TaxelFaults:
    """Faults that the values show: wires that broke, a short.

    The fabric pad is never still: in all of HAART's recordings, at rest and under hands, each of the 64
    taxels changes at least every 2 s, and none reads above 972. So a taxel that stands still is broken. Other
    pads are silent at rest; there stillness means nothing and is not reported.
    faults: those that last, in words.
    """

    def __init__(self) -> None:
        self._block: list[Frame] = []
        self._clock_s = 0.0
        self._activity = np.full((ROWS, COLUMNS), LIVELY_SHARE / 2)
        self._is_still = np.zeros((ROWS, COLUMNS), dtype=np.bool_)
        self._has_noise = False
        self._first_s = 0.0
        self._is_untouched = True
        self._first_changed = np.zeros((ROWS, COLUMNS))
        self._saturation = 0.0
        self._garbled = 0.0
        self.faults: dict[str, str] = {}
        self._changing_since_s: dict[str, float] = {}

    def update(self, frame: Frame, *, is_untouched: bool = True) -> None:
        """Take the next frame."""
        self._block.append(frame)
        self._is_untouched &= is_untouched
        span_ms = (frame.sensor_ms - self._block[0].sensor_ms) % CLOCK_MODULUS
        if span_ms < BLOCK_MS or len(self._block) < 3:
            return
        self._measure(np.stack([one.pressure for one in self._block]), _passed_s(self._block))
        self._block, self._is_untouched = [frame], is_untouched
        self._follow(self._current())

    def _measure(self, pressure: Counts, passed_s: float) -> None:
        """Take (T, 8, 8) frames, the first of which was taken before, and how long the others took."""
        self._clock_s += passed_s
        weight = 1.0 - math.exp(-passed_s / LASTS_S)
        if self._is_untouched:
            self._measure_changes((pressure[1:] != pressure[:-1]).mean(axis=0), passed_s, weight)
        is_saturated = (pressure[1:] >= SATURATED_COUNT).mean(axis=(1, 2)) >= 1 / 4
        self._saturation += weight * (float(is_saturated.mean()) - self._saturation)
        is_fast = passed_s <= (len(pressure) - 1) / GARBLED_HZ
        garbled = float(_jumps(pressure).mean()) if is_fast else 0.0
        self._garbled += weight * (garbled - self._garbled)

    def _measure_changes(self, changed: NDArray[np.float64], passed_s: float, weight: float) -> None:
        """Take the share of an untouched pad's frames in which each taxel (8, 8) changes."""
        self._activity += weight * (changed - self._activity)
        is_still = self._activity < STILL_SHARE
        self._is_still = is_still | (self._is_still & (self._activity < LIVELY_SHARE))
        if self._first_s < LASTS_S:
            self._first_changed += changed * passed_s
            self._first_s += passed_s
            seldom_changed = np.sort(self._first_changed, axis=None)[TAXELS // 4]
            self._has_noise = bool(seldom_changed > NOISY_SHARE * self._first_s)

    def _current(self) -> dict[str, str]:
        """Return what looks faulty now."""
        found: dict[str, str] = {}
        if self._saturation > (0.5 if "saturated" in self.faults else 0.9):
            found["saturated"] = "a quarter of the pad or more is at its limit: too heavy a load, a short?"
        elif self._has_noise and self._is_still.all():
            found["frozen"] = "frames arrive but no value changes: the pad is off its board, or it hangs"
        elif self._has_noise and self._is_still.any():
            found |= _still_parts(self._is_still)
        if self._garbled > (GARBLED_SHARE / 2 if "garbled" in self.faults else GARBLED_SHARE):
            found["garbled"] = (
                "values jump from frame to frame, as no hand makes them: another format, a bad line?"
            )
        return found

    def _follow(self, found: Mapping[str, str]) -> None:
        """Update `faults` with what has begun or ended, and stayed so for LASTS_S."""
        changing = found.keys() ^ self.faults.keys()
        self._changing_since_s = {kind: self._changing_since_s.get(kind, self._clock_s) for kind in changing}
        for kind, since_s in self._changing_since_s.items():
            if self._clock_s - since_s >= LASTS_S and self.faults.pop(kind, None) is None:
                self.faults[kind] = found[kind]


def _jumps(pressure: Counts) -> NDArray[np.bool_]:
    """Return for each of (T, 8, 8) frames with neighbours whether a taxel jumps in it alone.

    A jump of less than half of what the taxel reads before and after is noise under a load.
    """
    counts = pressure.astype(np.int64)
    before, now, after = counts[:-2], counts[1:-1], counts[2:]
    there, back = now - before, now - after
    jump = np.where(there * back > 0, np.minimum(np.abs(there), np.abs(back)), 0)
    is_jump = (jump >= JUMP_COUNTS) & (2 * jump >= np.maximum(before, after))
    return np.asarray(is_jump.any(axis=(1, 2)))


def _passed_s(frames: Sequence[Frame]) -> float:
    """Return how long frames took by the pad's clock; 1 s where the clock jumped."""
    clock_ms = np.array([frame.sensor_ms for frame in frames], dtype=np.int64)
    return float(np.minimum(np.diff(clock_ms) % CLOCK_MODULUS / 1000, 1.0).sum())


def _still_parts(is_still: NDArray[np.bool_]) -> dict[str, str]:
    """Name the rows, columns and single taxels (counted from 1) of a mask (8, 8)."""
    rows: NDArray[np.bool_] = is_still.sum(axis=1) == COLUMNS
    columns: NDArray[np.bool_] = is_still.sum(axis=0) == ROWS
    parts: dict[str, str] = {}
    lines = [f"row {row + 1}" for row in np.flatnonzero(rows)]
    lines += [f"column {column + 1}" for column in np.flatnonzero(columns)]
    if lines:
        parts["dead line"] = f"{', '.join(lines)} of the 8x8 grid stands still: a broken wire?"
    singles = np.argwhere(is_still & ~rows[:, None] & ~columns[None, :])
    if len(singles):
        places = ", ".join(f"row {row + 1} column {column + 1}" for row, column in singles[:4])
        more = f" and {len(singles) - 4} more" if len(singles) > 4 else ""
        parts["stuck taxel"] = f"the taxel at {places}{more} of the 8x8 grid stands still"
    return parts
