"""The one queue between threads: bounded, and never waited for by whoever fills it."""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Callable
from typing import Generic, TypeVar

Item = TypeVar("Item")


class DroppingQueue(Generic[Item]):
    """A bounded queue that gives up its oldest item when it is full, and counts it in `dropped`.

    may_drop: items to keep as long as there are others to give up are those for which it returns False.
    filled: notified when something is put; of several queues, one thread can wait on the same.
    """

    def __init__(
        self,
        capacity: int,
        may_drop: Callable[[Item], bool] = lambda item: True,
        filled: threading.Condition | None = None,
    ) -> None:
        self._capacity = capacity
        self._may_drop = may_drop
        self._items: deque[Item] = deque()
        self._filled = filled or threading.Condition()
        self.dropped = 0

    def put(self, item: Item) -> None:
        """Add an item; never blocks."""
        with self._filled:
            if len(self._items) >= self._capacity:
                index = next((i for i, held in enumerate(self._items) if self._may_drop(held)), 0)
                del self._items[index]
                self.dropped += 1
            self._items.append(item)
            self._filled.notify()

    def get(self, timeout_s: float | None = None) -> Item | None:
        """Take the oldest item, waiting for one at most `timeout_s` (None: for ever)."""
        with self._filled:
            if not self._filled.wait_for(lambda: self._items, timeout_s):
                return None
            return self._items.popleft()

    def take_all(self) -> list[Item]:
        """Take everything that waits, oldest first."""
        with self._filled:
            items = list(self._items)
            self._items.clear()
            return items

    def __len__(self) -> int:
        return len(self._items)
