"""The queue between threads: bounded; its writer never waits."""

import threading
import time
from collections import deque
from collections.abc import Callable, Iterable
from contextlib import suppress
from typing import Generic, TypeVar

Item = TypeVar("Item")


class Signal:
    """Wakes one waiting thread. It is a bare lock, because a Condition takes five times as long."""

    def __init__(self) -> None:
        self._asleep = threading.Lock()
        self._asleep.acquire()

    def set(self) -> None:
        """Wake the thread, or make its next wait return at once."""
        if self._asleep.locked():
            # Another thread may have released it first.
            with suppress(RuntimeError):
                self._asleep.release()

    def wait(self, timeout_s: float | None = None) -> bool:
        """Wait until it is set; return False if `timeout_s` passes first (None: no limit)."""
        return self._asleep.acquire(timeout=-1 if timeout_s is None else timeout_s)


class DroppingQueue(Generic[Item]):
    """A bounded queue with one reader. When it is full, it drops its oldest item and counts it in `dropped`.

    may_drop: returns False for items that are dropped only when the queue holds no others.
    filled: set on each `put`; several queues may share one, so that one thread waits for all.
    """

    def __init__(
        self,
        capacity: int,
        may_drop: Callable[[Item], bool] = lambda item: True,
        filled: Signal | None = None,
    ) -> None:
        self._capacity = capacity
        self._may_drop = may_drop
        self._items: deque[Item] = deque()
        self._lock = threading.Lock()
        self._filled = filled or Signal()
        self.dropped = 0

    def put(self, item: Item) -> None:
        """Add an item; never blocks."""
        self.put_all((item,))

    def put_all(self, items: Iterable[Item]) -> None:
        """Add items and wake the reader once, so that it does not wait for this thread in between."""
        with self._lock:
            for item in items:
                if len(self._items) >= self._capacity:
                    index = next((i for i, held in enumerate(self._items) if self._may_drop(held)), 0)
                    del self._items[index]
                    self.dropped += 1
                self._items.append(item)
        self._filled.set()

    def get(self, timeout_s: float | None = None) -> Item | None:
        """Return the oldest item, waiting for one at most `timeout_s` (None: no limit); None if none came."""
        until_s = None if timeout_s is None else time.monotonic() + timeout_s
        while not self._items:
            if not self._filled.wait(None if until_s is None else max(0.0, until_s - time.monotonic())):
                break
        return self.get_nowait()

    def get_nowait(self) -> Item | None:
        """Return the oldest item, or None."""
        with self._lock:
            return self._items.popleft() if self._items else None

    def take_all(self) -> list[Item]:
        with self._lock:
            items = list(self._items)
            self._items.clear()
            return items

    def __len__(self) -> int:
        return len(self._items)
