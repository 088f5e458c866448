"""Asks the network whether something touches the pad, and compares its answers with those at rest."""

from collections import deque
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from touchd.drivers.frame import COLUMNS, ROWS

Window = NDArray[np.float32]
PNoTouch = Callable[[Window], float]
"""The network's probability that nothing touches the pad in (T, 8, 8) counts."""
Question = Callable[[Window, Window], float]
"""The same, of a pad that rests at (64,) counts."""

# The network is asked three times a second; three answers together begin or end a touch.
ASK_FRAMES, ANSWERS = 18, 3
# Mean p_no_touch below which they begin a touch, and above which they end one. At 0.15, a jolt of the
# breathing robot begins one.
TOUCH, NONE = 0.12, 0.5
# A single answer below this keeps a touch from ending. If the answers at rest are below it, the network does
# not know the pad, and is ignored.
DOUBT = 0.2
# On a pad unlike those it learned from, as under mains hum, p_no_touch is lower at rest. The limits are then
# this share of it.
REST_SHARE = 0.6
# Share by which p_no_touch at rest follows an answer: slowly, since it may come from an unnoticed touch.
FOLLOWS = 0.05
# At rest, frames count as those in which no touch was seen, without asking again, if their means differ by no
# more than this, summed over the pad, and no taxel exceeds its peak by more. HAART's do nine times in ten.
SAME_COUNTS, SAME_PEAK_COUNTS = 13.0, 2.0


class NetworkCheck:
    """Compares answers with those at rest. p_no_touch: None without a network. is_finer: than 8x8 taxels."""

    def __init__(self, p_no_touch: PNoTouch | None, is_finer: bool = False) -> None:
        self._p_no_touch, self._is_finer = p_no_touch, is_finer
        self._at_rest, self._answers_at_rest = 0.0, 0
        self._answers: deque[float] = deque(maxlen=ANSWERS)
        # The last answer at rest that saw no touch, and the frames it was about.
        self._untouched: tuple[float, Window] | None = None

    @property
    def is_there(self) -> bool:
        return self._p_no_touch is not None

    @property
    def knows_rest(self) -> bool:
        """Whether the network recognises this pad at rest as untouched."""
        return self._at_rest >= DOUBT

    @property
    def knows_pad(self) -> bool:
        """Whether the network can tell a hand from what it has left; it has learned from no finer pad."""
        # A firm pad's first answers may be misleadingly high.
        return not self._is_finer and self.knows_rest and self._answers_at_rest > ANSWERS

    def forget_rest(self) -> None:
        """Forget the answers at rest: it may be another pad."""
        self._at_rest, self._answers_at_rest, self._untouched = 0.0, 0, None
        self._answers.clear()

    def forget_answers(self) -> None:
        self._answers.clear()

    def is_below(self, p_no_touch: float, frames: Window) -> bool:
        """Whether p_no_touch of (T, 64) counts is below a limit; True without a network."""
        return self._ask(frames) < self._limit(p_no_touch)

    def sees_touch(self, frames: Window, p_no_touch: float) -> bool:
        """Like `is_below`, but False unless the network knows the pad at rest."""
        return self.knows_rest and self.is_below(p_no_touch, frames)

    def begins_touch(self, frames: Window) -> bool:
        """Ask about a pad that seems untouched; return whether the last answers together see a touch."""
        answer = self._answered_before(frames)
        if answer is None:
            answer = self._ask(frames)
            self._untouched = (answer, frames.copy()) if answer >= self._limit(NONE) else None
        self._answers.append(answer)
        self._answers_at_rest += 1
        at_rest = self._at_rest or answer
        self._at_rest = at_rest + (answer - at_rest) * FOLLOWS
        return self.knows_rest and len(self._answers) == ANSWERS and self._mean < self._limit(TOUCH)

    def _answered_before(self, frames: Window) -> float | None:
        """Return the last answer at rest if it saw no touch, and the newest frames read the same."""
        if self._untouched is None:
            return None
        answer, before = self._untouched
        newest = frames[-ASK_FRAMES:]
        change = np.abs(newest.mean(axis=0) - before.mean(axis=0)).sum()
        is_no_higher = newest.max(axis=0) <= before.max(axis=0) + SAME_PEAK_COUNTS
        return answer if change <= SAME_COUNTS and is_no_higher.all() else None

    def follow_touch(self, frames: Window) -> None:
        """Ask about the last second of a touch."""
        self._answers.append(self._ask(frames))

    @property
    def ends_touch(self) -> bool:
        """Whether the last answers together see no touch."""
        is_full = len(self._answers) == ANSWERS
        return is_full and self._mean >= self._limit(NONE) and min(self._answers) >= self._limit(DOUBT)

    @property
    def _mean(self) -> float:
        return sum(self._answers) / len(self._answers)

    def _ask(self, frames: Window) -> float:
        return 0.0 if self._p_no_touch is None else self._p_no_touch(frames.reshape(-1, ROWS, COLUMNS))

    def _limit(self, p_no_touch: float) -> float:
        return min(p_no_touch, REST_SHARE * self._at_rest) if self.knows_rest else p_no_touch
