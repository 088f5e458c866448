"""Pauses before another attempt."""

import random


class Backoff:
    """Pauses that double from the first to the cap, each shortened at random by up to half."""

    def __init__(self, first_s: float, cap_s: float) -> None:
        self._first_s = first_s
        self._cap_s = cap_s
        self._next_s = first_s

    def pause_s(self) -> float:
        """Return how long to wait now, in seconds."""
        pause_s = self._next_s
        self._next_s = min(2 * pause_s, self._cap_s)
        return pause_s * random.uniform(0.5, 1.0)

    def reset(self) -> None:
        self._next_s = self._first_s
