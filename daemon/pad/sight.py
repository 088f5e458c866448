"""Whether the network sees a touch, relative to what it says of the pad at rest."""

from collections import deque
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from touchd.daemon.pad.baseline import Taxels
from touchd.drivers.frame import COLUMNS, ROWS

NoTouch = Callable[[NDArray[np.float32]], float]
Frames = NDArray[np.float32]

# The network sees a touch when its mean no-touch probability over three looks is below the first, and none
# when it is above the second.
TOUCH, NONE = 0.15, 0.5
# A single look this low speaks against the end of a touch.
DOUBT = 0.2
LOOKS = 3
# On a pad unlike those it learned from, as under mains hum, these are lower; far below, it is ignored.
REST_SHARE = 0.6
KNOWN_REST = 0.2
# The no-touch probability at rest rises over ten looks and falls more slowly, as a touch may go unnoticed.
RISES, FALLS = 0.1, 0.05
# The network is asked three times a second.
ASK_FRAMES = 18
# A pad at rest is not looked at again while its newest frames read as those in which no touch was seen: their
# means, summed over the pad, and each taxel's highest differ by no more. HAART's do nine times in ten.
SAME_COUNTS = 13.0
SAME_HIGHEST_COUNTS = 2.0


class Sight:
    """Asks the network now and then. no_touch: its probability that nothing touches the pad in (T, 8, 8)."""

    def __init__(self, no_touch: NoTouch | None) -> None:
        self._no_touch = no_touch
        self._at_rest: float | None = None
        self._looks: deque[float] = deque(maxlen=LOOKS)
        self._none: tuple[float, Taxels, Taxels] | None = None

    @property
    def is_there(self) -> bool:
        return self._no_touch is not None

    @property
    def knows_rest(self) -> bool:
        """Whether the network has known this pad at rest."""
        return self._at_rest is not None and self._at_rest >= KNOWN_REST

    @property
    def is_lost(self) -> bool:
        """Whether the network takes this pad at rest for a touch."""
        return self._at_rest is not None and self._at_rest < KNOWN_REST

    @property
    def last_is_none(self) -> bool:
        """Whether it saw no touch in its last look."""
        return bool(self._looks) and self._looks[-1] >= self._than(NONE)

    @property
    def is_none(self) -> bool:
        """Whether it saw no touch in its last looks together."""
        few = len(self._looks) < LOOKS
        return not few and self._mean >= self._than(NONE) and min(self._looks) >= self._than(DOUBT)

    def forget_rest(self) -> None:
        """Forget the pad's rest: it may be another pad."""
        self._at_rest = self._none = None
        self._looks.clear()

    def forget_looks(self) -> None:
        self._looks.clear()

    def is_below(self, no_touch: float, frames: Frames) -> bool:
        """Whether no touch is less probable than that in (T, 64) counts; without a network, always."""
        return self._ask(frames) < self._than(no_touch)

    def sees_touch(self, frames: Frames, doubt: float = TOUCH) -> bool:
        """Whether the network, which knows the pad at rest, sees a touch in these."""
        return self.knows_rest and self.is_below(doubt, frames)

    def look(self, frames: Frames) -> None:
        """Look at the last second of a touch."""
        self._looks.append(self._ask(frames))

    def look_at_rest(self, frames: Frames) -> bool:
        """Look at a pad that seems at rest; return whether there has been a touch in the last looks."""
        seen = self._seen_before(frames)
        if seen is None:
            seen = self._ask(frames)
            is_none = seen >= self._than(NONE)
            self._none = (seen, frames.mean(axis=0), frames.max(axis=0)) if is_none else None
        self._looks.append(seen)
        if self._at_rest is None:
            self._at_rest = seen
        self._at_rest += (seen - self._at_rest) * (RISES if seen > self._at_rest else FALLS)
        return self.knows_rest and len(self._looks) == LOOKS and self._mean < self._than(TOUCH)

    def _seen_before(self, frames: Frames) -> float | None:
        """Return what was last seen at rest if it was no touch and the newest frames read the same."""
        if self._none is None:
            return None
        seen, mean, highest = self._none
        new = frames[-ASK_FRAMES:]
        is_same = float(np.abs(new.mean(axis=0) - mean).sum()) <= SAME_COUNTS
        return seen if is_same and (new.max(axis=0) <= highest + SAME_HIGHEST_COUNTS).all() else None

    @property
    def _mean(self) -> float:
        return sum(self._looks) / len(self._looks)

    def _ask(self, frames: Frames) -> float:
        return 0.0 if self._no_touch is None else self._no_touch(frames.reshape(-1, ROWS, COLUMNS))

    def _than(self, no_touch: float) -> float:
        if self._at_rest is None or not self.knows_rest:
            return no_touch
        return min(no_touch, REST_SHARE * self._at_rest)
