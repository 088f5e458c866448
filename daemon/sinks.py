"""Where events go. Each sink has its own bounded queue and its own thread, so that none can slow the loop."""

from __future__ import annotations

import logging
import os
import select
import threading
import typing
from abc import ABC, abstractmethod
from collections import deque
from collections.abc import Callable
from typing import Generic, TypeVar

from daemon.events import Event, Prediction, SensorEvent, encode, epoch_s
from daemon.kept.journal import Journal
from drivers.robot.link import RobotLink, RobotMessage, State

log = logging.getLogger(__name__)

Item = TypeVar("Item")

CAPACITY = 1000
WRITABLE_WAIT_S = 0.1
ROBOT_STOP_S = 1.0


class Sink(typing.Protocol):
    """What the daemon asks of a destination of events."""

    name: str

    def put(self, event: Event) -> None:
        """Take an event; returns at once, whatever the destination is doing."""
        ...

    @property
    def dropped(self) -> int:
        """Events that the destination was too slow for."""
        ...

    def stop(self, timeout_s: float) -> None:
        """Pass on what is queued, as far as the time allows, and end."""
        ...


class QueuedSink(ABC, Generic[Item]):
    """A thread that passes items, events mostly, on one by one; a full queue drops and counts its oldest."""

    def __init__(self, name: str, capacity: int = CAPACITY) -> None:
        self.name = name
        self.dropped = 0
        self._capacity = capacity
        self._items: deque[Item] = deque()
        self._changed = threading.Condition()
        self._draining = False
        self._abandoned = threading.Event()
        self._thread = threading.Thread(target=self._run, name=f"touchd-{name}", daemon=True)
        self._thread.start()

    def put(self, item: Item) -> None:
        """Queue an event; never blocks."""
        with self._changed:
            if len(self._items) == self._capacity:
                self._items.popleft()
                self.dropped += 1
            self._items.append(item)
            self._changed.notify()

    def stop(self, timeout_s: float) -> None:
        """Write what is queued, for at most half of `timeout_s`, then give up the rest; may be repeated."""
        with self._changed:
            self._draining = True
            self._changed.notify()
        self._thread.join(timeout_s / 2)
        self._abandoned.set()
        self._thread.join(timeout_s / 2)

    @abstractmethod
    def write(self, item: Item) -> None:
        """Pass one event on; may block, but not for long once `_abandoned` is set."""

    def _run(self) -> None:
        while not self._abandoned.is_set():
            with self._changed:
                while not self._items and not self._draining:
                    self._changed.wait()
                if not self._items:
                    break
                item = self._items.popleft()
            try:
                self.write(item)
            except Exception:
                log.exception("%s: an event could not be passed on", self.name)


class LinesSink(QueuedSink[Event]):
    """One JSON line an event to a file descriptor, usually standard output.

    on_gone: called once, from the sink's thread, when nobody reads any more.
    """

    def __init__(self, fd: int, on_gone: Callable[[], None], capacity: int = CAPACITY) -> None:
        self._fd = fd
        self._on_gone = on_gone
        super().__init__("stdout", capacity)

    def write(self, item: Event) -> None:
        """Write one line; waits for a slow reader, and for none once it is gone."""
        data = encode(item) + b"\n"
        try:
            while data and not self._abandoned.is_set():
                # A write of at most PIPE_BUF bytes to a pipe that is writable does not block (POSIX).
                if select.select([], [self._fd], [], WRITABLE_WAIT_S)[1]:
                    data = data[os.write(self._fd, data[: select.PIPE_BUF]) :]
        except OSError:
            self._abandoned.set()
            self._on_gone()


class JournalSink(QueuedSink[Event]):
    """One JSON line an event to the journal, if there is one."""

    def __init__(self, journal: Journal | None, capacity: int = CAPACITY) -> None:
        self._journal = journal
        self._using = threading.Lock()
        super().__init__("journal", capacity)

    def use(self, journal: Journal | None) -> None:
        """Write to another journal from the next line on, and close the one before; from any thread."""
        with self._using:
            before, self._journal = self._journal, journal
            if before is not None:
                before.close()

    def write(self, item: Event) -> None:
        """Append one line."""
        with self._using:
            if self._journal is not None:
                self._journal.append(encode(item))

    def stop(self, timeout_s: float) -> None:
        """Write what is queued and close the file."""
        super().stop(timeout_s)
        # A disk that hangs keeps the thread and the lock; the file is then left as it is.
        if not self._thread.is_alive():
            self.use(None)


class RobotSink:
    """The robot, if there is one: told what is to be told, and whether there is a pad.

    The link, which is started here, has its own queue and thread.
    """

    name = "robot"

    def __init__(self, link: RobotLink | None) -> None:
        self._link: RobotLink | None = None
        self._sequence = 0
        self._pads: dict[str, State] = {}
        self._dropped_before = 0
        self.use(link)

    def use(self, link: RobotLink | None) -> None:
        """Tell another robot from now on; from any thread. Leaving the one before may take ROBOT_STOP_S.

        What is put meanwhile waits for the new one. The numbers of the messages go on.
        """
        if link is not None:
            for pad, state in self._pads.items():
                link.set_status(state, pad)
        before, self._link = self._link, link
        if before is not None:
            before.stop(ROBOT_STOP_S)
            self._dropped_before += _given_up(before)
        if link is not None:
            link.start()

    @property
    def dropped(self) -> int:
        """Messages that the robot was too slow for, or not there for."""
        return self._dropped_before + (_given_up(self._link) if self._link is not None else 0)

    def put(self, event: Event) -> None:
        """Publish a prediction that is told, act on any; returns at once. Call it from one thread."""
        link = self._link
        if isinstance(event, SensorEvent):
            self._pads[event.pad] = event.state
        if link is None:
            return
        if isinstance(event, Prediction):
            self._sequence += event.told
            message = RobotMessage(
                gesture=event.gesture,
                confidence=event.confidence,
                time_s=epoch_s(event.time),
                stage=event.stage,
                touch=event.touch,
                sequence=self._sequence,
                pad=event.pad,
            )
            if event.told:
                link.publish(message)
            else:
                link.settle(message)
        elif isinstance(event, SensorEvent):
            link.set_status(event.state, event.pad)

    def stop(self, timeout_s: float) -> None:
        """Say goodbye to the robot."""
        if self._link is not None:
            self._link.stop(timeout_s)


def _given_up(link: RobotLink) -> int:
    counts = link.counts
    return counts.dropped + counts.stale
