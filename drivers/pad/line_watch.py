"""Warns when a part of a pad's frames is refused: a bad cable, or presses beyond the full scale."""

import logging
import math
from dataclasses import replace

from drivers.pad.parser import FrameParser
from drivers.pad.watch import SAME_TROUBLE_S

log = logging.getLogger(__name__)

LOOK_S = 10.0
# One lost frame in fifty is a fault that will grow.
MANY_SHARE = 0.02
# A damaged line often breaks the value first looked at, so nearly all must be above the full scale.
MOSTLY = 0.9


class LineWatch:
    """Looks at a parser's counts every LOOK_S; warns at most every SAME_TROUBLE_S. where: the pad's port."""

    def __init__(self, parser: FrameParser, where: str) -> None:
        self._parser = parser
        self._where = where
        self._before = replace(parser.counts)
        self._looked_s = -math.inf
        self._warned_s = -math.inf

    def update(self, now_s: float) -> None:
        passed_s = now_s - self._looked_s
        if passed_s < LOOK_S:
            return
        counts, before = self._parser.counts, self._before
        self._before, self._looked_s = replace(counts), now_s
        if passed_s > 2 * LOOK_S:
            # The first frames, or those after a pause, which is told elsewhere.
            return
        intact, refused = counts.frames - before.frames, counts.bad - before.bad
        # Where no frame at all is intact, the sensor is down and says why.
        share = refused / (intact + refused) if intact else 0.0
        if share <= MANY_SHARE or now_s - self._warned_s < SAME_TROUBLE_S:
            return
        self._warned_s = now_s
        if counts.bad_value - before.bad_value >= MOSTLY * refused:
            why = (
                f"with values above full_scale {self._parser.format.full_scale}; "
                "if firm presses do that, set a larger one in sensor.format"
            )
        else:
            is_cable = "://" not in self._where
            why = "damaged on the way; " + (
                "try a shorter cable and another USB port, no hub"
                if is_cable
                else "does another board send there too?"
            )
        log.warning("%s: %.0f %% of the last frames were refused, %s", self._where, 100 * share, why)
