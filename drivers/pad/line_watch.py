"""Warns when a part of a pad's frames is refused, or when the pad's clock does not count milliseconds."""

import logging
import math
from dataclasses import replace

from touchd.drivers.frame import CLOCK_MODULUS
from touchd.drivers.pad.parser import FrameParser
from touchd.drivers.pad.watch import SAME_TROUBLE_S

log = logging.getLogger(__name__)

LOOK_S = 10.0
# One lost frame in fifty is a fault that will grow.
MANY_SHARE = 0.02
# A line that is held up moves the clock by less, over LOOK_S.
CLOCK_OFF = 0.2
# After as long without a byte the clock may have gone on, or its bytes may be lost.
PAUSE_S = 1.0
# More is a clock that started anew.
MOST_MS_A_SECOND = 10_000


class LineWatch:
    """Looks at a parser's counts every LOOK_S; warns at most every SAME_TROUBLE_S. where: the pad's port."""

    def __init__(self, parser: FrameParser, where: str) -> None:
        self._parser = parser
        self._where = where
        self._before = replace(parser.counts)
        self._has_told_clipped = False
        self._clock_ms: int | None = None
        self._looked_s = self._heard_s = -math.inf
        self._warned_s = self._clock_warned_s = -math.inf

    def update(self, now_s: float, sensor_ms: int | None = None) -> None:
        """Take what has just arrived. sensor_ms: the last frame's clock; None where no frame was intact."""
        if now_s - self._heard_s > PAUSE_S:
            self.forget_clock()
        self._heard_s = now_s
        passed_s = now_s - self._looked_s
        if passed_s < LOOK_S:
            return
        counts, before, clock_ms = self._parser.counts, self._before, self._clock_ms
        self._before, self._looked_s, self._clock_ms = replace(counts), now_s, sensor_ms
        if passed_s > 2 * LOOK_S:
            # The first frames, or those after a pause, which is told elsewhere.
            return
        if sensor_ms is not None and clock_ms is not None:
            self._check_clock((sensor_ms - clock_ms) % CLOCK_MODULUS / passed_s, now_s)
        if counts.clipped and not self._has_told_clipped:
            self._has_told_clipped = True
            log.warning(
                "%s: values above full_scale %g are cut to it; set the most that a cell can send in "
                "sensor.format",
                self._where,
                self._parser.format.full_scale,
            )
        intact, refused = counts.frames - before.frames, counts.bad - before.bad
        # Where no frame at all is intact, the sensor is down and says why.
        share = refused / (intact + refused) if intact else 0.0
        if share <= MANY_SHARE or now_s - self._warned_s < SAME_TROUBLE_S:
            return
        self._warned_s = now_s
        why = "try a shorter cable and another USB port, no hub"
        if "://" in self._where:
            why = "does another board send there too?"
        log.warning(
            "%s: %.0f %% of the last frames were refused, damaged on the way; %s",
            self._where,
            100 * share,
            why,
        )

    def forget_clock(self) -> None:
        """Compare no clock with one before: of another pad perhaps, or before a pause."""
        self._clock_ms = None

    def _check_clock(self, ms_a_second: float, now_s: float) -> None:
        if ms_a_second > MOST_MS_A_SECOND or abs(ms_a_second - 1000) <= 1000 * CLOCK_OFF:
            return
        if now_s - self._clock_warned_s >= SAME_TROUBLE_S:
            self._clock_warned_s = now_s
            log.warning(
                "%s: the pad's clock counts %.0f in a second; it must count milliseconds, or touches seem "
                "shorter or longer than they are",
                self._where,
                ms_a_second,
            )
