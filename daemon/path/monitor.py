"""Monitors a pad: decides on its state (up, degraded, down) and logs its faults, at a limited rate."""

import logging
import math
from collections import deque
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from touchd.drivers.faults import FaultLog
from touchd.drivers.frame import (
    CLOCK_MODULUS,
    COLUMNS,
    DEFAULT_PAD,
    FRAME_RATE_HZ,
    MIN_RATE_HZ,
    ROWS,
    Frame,
    SensorState,
)
from touchd.drivers.pace import steps_ms
from touchd.drivers.pad.parser import FrameParser
from touchd.model.detector import REST_FRAMES

log = logging.getLogger(__name__)


class Fault(NamedTuple):
    """A fault of a pad.

    words: what is found; {} is a detail. advice: what to do. degrades: whether touches are missed.
    """

    words: str
    advice: str
    degrades: bool


# The gravest first.
FAULTS = {
    "gaps": Fault("no touch is recognised: {}", "", True),
    "restarts": Fault(
        "the pad restarted {} times in a minute, which may cut touches; is its supply too weak, or does its "
        "firmware crash?",
        "",
        True,
    ),
    "frozen": Fault(
        "frames arrive but no value changes: the pad is off its board, or it hangs",
        "press the reset button of its board; look at the cable between pad and board",
        True,
    ),
    "noise": Fault(
        "light touches are not recognised: the pad is noisy though nobody touches it; a motor, mains hum, a "
        "loose wire? touchd doctor says more",
        "",
        True,
    ),
    "dead line": Fault(
        "{} of the 8x8 grid stands still: a broken wire?", "look at that wire and its plug", False
    ),
    "dead taxel": Fault(
        "the taxel at {} of the 8x8 grid stands still",
        "look at the pad there: a thread that came loose, a short?",
        False,
    ),
}

# A pad is checked every half second, which costs a twentieth of a check per frame. A fault has begun, or
# ended, after ten equal checks in a row: the noise that a hand leaves behind lasts three seconds.
CHECK_MS = 500
LASTING_CHECKS = 10
# Mean noise above which light touches are missed; a taxel quieter than HAART's counts like one of HAART's.
USUAL_NOISE_COUNTS, MOST_NOISE_COUNTS = 1.0, 1.4
# A pad that restarts this often in a minute is degraded.
OFTEN_RESTARTS = 3
# On a pad with noise, a taxel that stands still for this long is broken: each taxel of HAART's pad changes
# at least every 2 s. A pad has noise if, in as long a time without a hand, three quarters of its taxels
# change in this share of the frames, as on HAART's and the robot's pads; others are silent at rest.
STILL_S = 6.0
NOISY_SHARE = 0.3


class PadMonitor:
    """Follows a pad's frames and states; each method returns the pad's state if it has changed.

    name: the pad's, for the log. parser: its counts show restarts of the board.
    """

    def __init__(self, name: str = DEFAULT_PAD, parser: FrameParser | None = None) -> None:
        self._prefix = "" if name == DEFAULT_PAD else f"{name}: "
        self._log = FaultLog(log, self._prefix)
        self._parser = parser
        self._restarts = 0 if parser is None else parser.counts.restarts
        self._restarted_s: deque[float] = deque([-math.inf] * OFTEN_RESTARTS, maxlen=OFTEN_RESTARTS)
        self._taxels = TaxelFaults()
        self._state: SensorState | None = None
        self._lasting: dict[str, str] = {}
        self._begin()

    def _begin(self) -> None:
        """Reset for another stream of frames."""
        self._block: list[Frame] = []
        self._is_untouched = True
        self._without_gap = 0
        # Whether the untouched pad was noisy since the last check; None if its noise was not measured.
        self._is_noisy: bool | None = None
        # How many checks in a row have contradicted each fault's present state.
        self._contradicted: dict[str, int] = {}

    def on_sensor(self, state: SensorState) -> SensorState | None:
        """Take what the reader reports: that frames come, or after each attempt that none do."""
        advice = "leave the pad alone for half a second, while its rest is measured"
        if state.state == "down":
            if not self._log.begin("down", state.reason, cause=state.cause):
                return None
            self._begin()
            for kind in ("gaps", "noise"):
                self._log.end(kind)
                self._lasting.pop(kind, None)
        elif self._state is None:
            log.info("%s%s; %s", self._prefix, state.reason, advice)
        else:
            self._log.end("down", f"{state.reason} again; {advice}")
        self._state = state
        return state

    def on_rest(self, noise: NDArray[np.float32]) -> None:
        """Take the deviation of each of the untouched pad's 64 taxels, in counts."""
        self._is_noisy = float(np.maximum(noise, USUAL_NOISE_COUNTS).mean()) > MOST_NOISE_COUNTS

    def on_frame(self, frame: Frame, *, restarted: bool, is_untouched: bool = True) -> SensorState | None:
        """Take the next frame. restarted: whether the grid restarted. is_untouched: whether no hand is on."""
        self._block.append(frame)
        self._without_gap = 0 if restarted else self._without_gap + 1
        self._is_untouched &= is_untouched
        if (frame.sensor_ms - self._block[0].sensor_ms) % CLOCK_MODULUS < CHECK_MS or len(self._block) < 3:
            return None
        found = self._gaps() | self._often_restarted(frame.host_s)
        if self._is_untouched:
            self._taxels.update(self._block)
        found |= self._taxels.found
        if self._is_noisy or (self._is_noisy is None and "noise" in self._lasting):
            found["noise"] = FAULTS["noise"].words
        self._block, self._is_untouched, self._is_noisy = [frame], is_untouched, None
        return self._follow(found, frame.host_s)

    def _gaps(self) -> dict[str, str]:
        """Return the fault that rest cannot be measured, as frames have gaps or come too seldom."""
        took_s = self._block[-1].host_s - self._block[0].host_s
        rate_hz = (len(self._block) - 1) / max(took_s, 0.001)
        if rate_hz < MIN_RATE_HZ - 0.5:
            why = f"{rate_hz:.1f} frames a second come, and {MIN_RATE_HZ:.0f} or more are needed, best "
            return {"gaps": FAULTS["gaps"].words.format(f"{why}{FRAME_RATE_HZ:.0f}")}
        if self._without_gap < min(REST_FRAMES, len(self._block) - 1):
            why = "frames come with gaps; are they lost on the way, or do two boards send there?"
            return {"gaps": FAULTS["gaps"].words.format(why)}
        return {}

    def _often_restarted(self, now_s: float) -> dict[str, str]:
        """Return the fault that the board restarts often, by the parser's count."""
        if self._parser is not None and self._parser.counts.restarts != self._restarts:
            self._restarts = self._parser.counts.restarts
            self._restarted_s.append(now_s)
        first_s, last_s = self._restarted_s[0], self._restarted_s[-1]
        is_often = max(last_s - first_s, now_s - last_s) <= 60.0
        return {"restarts": FAULTS["restarts"].words.format(OFTEN_RESTARTS)} if is_often else {}

    def _follow(self, found: Mapping[str, str], now_s: float) -> SensorState | None:
        """Log the faults that have begun and ended; return the pad's state if it has changed."""
        changing = found.keys() ^ self._lasting.keys()
        self._contradicted = {kind: self._contradicted.get(kind, 0) + 1 for kind in changing}
        for kind in FAULTS:
            if self._contradicted.get(kind, 0) >= LASTING_CHECKS:
                if kind in self._lasting:
                    self._log.end(kind, f"no longer: {self._lasting.pop(kind)}", now_s)
                else:
                    self._lasting[kind] = found[kind]
            if kind in self._lasting:
                # Details such as the taxels may change while the fault lasts.
                self._lasting[kind] = found.get(kind, self._lasting[kind])
                self._log.begin(kind, self._lasting[kind], now_s, cause=self._lasting[kind])
        worst = next((kind for kind in FAULTS if kind in self._lasting and FAULTS[kind].degrades), "")
        before = self._state.cause if self._state is not None and self._state.state == "degraded" else ""
        if worst == before:
            return None
        self._state = SensorState("up", "touches are recognised again")
        if worst:
            self._state = SensorState("degraded", self._lasting[worst], worst)
        return self._state


class TaxelFaults:
    """Taxels that stand still. found: faults in words, by kind."""

    def __init__(self) -> None:
        self.found: dict[str, str] = {}
        self._still_s = np.zeros((ROWS, COLUMNS))
        self._first_s = 0.0
        self._first_changed = np.zeros((ROWS, COLUMNS))

    def update(self, block: Sequence[Frame]) -> None:
        """Take frames of an untouched pad; the first one repeats the last one of the call before."""
        # A step of more than a second counts as one.
        passed_s = float(np.minimum(steps_ms(block), 1000).sum()) / 1000
        pressure = np.stack([frame.pressure for frame in block])
        changed = (pressure[1:] != pressure[:-1]).mean(axis=0)
        self._still_s = np.where(changed > 0, 0.0, self._still_s + passed_s)
        if self._first_s < STILL_S:
            self._first_changed += changed * passed_s
            self._first_s += passed_s
        seldom_changed = np.sort(self._first_changed, axis=None)[ROWS * COLUMNS // 4]
        is_still = self._still_s >= STILL_S
        self.found = {}
        if seldom_changed > NOISY_SHARE * self._first_s:
            self.found = {"frozen": FAULTS["frozen"].words} if is_still.all() else _still_parts(is_still)


def _still_parts(is_still: NDArray[np.bool_]) -> dict[str, str]:
    """Name the rows, columns and single taxels (counted from 1) of a mask (8, 8)."""
    rows, columns = (np.asarray(is_still.all(axis=axis)) for axis in (1, 0))
    lines = [f"row {row + 1}" for row in np.flatnonzero(rows)]
    lines += [f"column {column + 1}" for column in np.flatnonzero(columns)]
    singles = is_still & ~rows[:, None] & ~columns[None, :]
    parts = {"dead line": ", ".join(lines), "dead taxel": places(singles)}
    return {kind: FAULTS[kind].words.format(where) for kind, where in parts.items() if where}


def places(mask: NDArray[np.bool_], most: int = 4) -> str:
    """Name the first few taxels of a mask (8, 8), counted from 1; "" if there are none."""
    found = np.argwhere(mask)
    named = ", ".join(f"row {row + 1} column {column + 1}" for row, column in found[:most])
    return f"{named} and {len(found) - most} more" if len(found) > most else named
