"""Where events go. Each sink has its own bounded queue and its own thread, so that none can slow the loop."""

import logging
import os
import select
import threading
import typing
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from typing import Generic, TypeVar

import msgspec

from touchd.daemon.path.events import Event, RobotEvent, SensorEvent, TouchBegan
from touchd.drivers.errors import DISK_FULL
from touchd.drivers.faults import FaultLog
from touchd.drivers.queue import DroppingQueue

log = logging.getLogger(__name__)

Item = TypeVar("Item")

WRITABLE_WAIT_S = 0.1


class Sink(typing.Protocol):
    """The interface of a destination of events."""

    def start(self) -> None:
        """Begin to pass events on, including those already put."""

    def put(self, event: Event) -> None:
        """Take an event; returns at once, whatever the destination is doing."""

    def stop(self, timeout_s: float) -> None:
        """Pass on queued items within the time limit, then end; may be called without `start`."""


class EventFanout:
    """Hands every event to every sink; any thread may call it, and no sink makes it wait.

    sinks: in order; the robot comes last, so that its own events follow the answer that caused them.
    touches: number of touches that began. tags: returns those to put into an event.
    """

    def __init__(self) -> None:
        self.sinks: tuple[Sink, ...] = ()
        self.touches = 0
        self.tags: Callable[[], Mapping[str, str]] = dict

    def emit(self, event: Event) -> None:
        # The robot's threads emit events too, but no touches: only one thread may count.
        if isinstance(event, TouchBegan):
            self.touches += 1
        if tags := self.tags():
            event = msgspec.structs.replace(event, tags=tags)
        for sink in self.sinks:
            sink.put(event)


class QueuedSink(ABC, Generic[Item]):
    """A sink with a queue, and a thread that passes its items (mostly events) on one by one.

    A full queue drops its oldest item, and states only if it holds nothing else; the log says how many.
    log: what losses are logged to.
    """

    capacity = 1000

    def __init__(self, name: str, log: logging.Logger = log) -> None:
        self.name = name
        self._log = log
        self._faults = FaultLog(log, f"{name}: ")
        self._items: DroppingQueue[Item | None] = DroppingQueue(self.capacity, self.may_drop)
        self._abandoned = threading.Event()
        self._thread = threading.Thread(target=self._run, name=f"touchd-{name}", daemon=True)

    def start(self) -> None:
        self._thread.start()

    @property
    def dropped(self) -> int:
        return self._items.dropped

    def put(self, item: Item) -> None:
        self._items.put(item)

    def stop(self, timeout_s: float) -> None:
        """Write what is queued, for at most half of `timeout_s`, then give up the rest; may be repeated."""
        if self._thread.ident is None:
            return
        self._items.put(None)
        self._thread.join(timeout_s / 2)
        is_cut_short = not self._abandoned.is_set()
        self._abandoned.set()
        self._thread.join(timeout_s / 2)
        if is_cut_short and (left := sum(item is not None for item in self._items.take_all())):
            lost = "%s: %d events or more are lost: not passed on before the end"
            self._log.warning(lost, self.name, left)

    def may_drop(self, item: Item | None) -> bool:
        """Whether an item may be dropped first: not the end marker, nor a state, which stays valid."""
        return item is not None and not isinstance(item, SensorEvent | RobotEvent)

    @abstractmethod
    def write(self, item: Item) -> None:
        """Pass one item on; may block, but not for long once `_abandoned` is set."""

    def _run(self) -> None:
        while not self._abandoned.is_set() and (item := self._items.get()) is not None:
            try:
                self.write(item)
            except Exception:
                self._log.exception("%s: an event could not be passed on", self.name)
            why = "it is away, too slow, or its disk is full"
            over = f"nothing is lost any more; {self.dropped} events or frames were"
            self._faults.count("dropped", self.dropped, f"events or frames are being lost: {why}", over)
        if self.dropped:
            self._log.warning("%s: %d events or frames were lost in all", self.name, self.dropped)


class LinesSink(QueuedSink[Item]):
    """Writes lines to a file descriptor, which may have no reader or a full disk.

    form: returns an item as a line, without its newline. on_gone: called once, from the sink's thread, when
    the reader is gone.
    """

    def __init__(
        self,
        name: str,
        fd: int,
        form: Callable[[Item], bytes],
        on_gone: Callable[[], None] = lambda: None,
        log: logging.Logger = log,
    ) -> None:
        super().__init__(name, log)
        self._fd = fd
        self._form = form
        self._on_gone = on_gone
        self._is_cut_off = False

    def write(self, item: Item) -> None:
        """Write one line; waits for a slow reader, not for one that is gone. A full disk loses the line."""
        # First end the line that a full disk cut off.
        data = b"\n" * self._is_cut_off + self._form(item) + b"\n"
        try:
            while data and not self._abandoned.is_set():
                # A write of at most PIPE_BUF bytes to a pipe that is writable does not block (POSIX).
                if select.select([], [self._fd], [], WRITABLE_WAIT_S)[1]:
                    data = data[os.write(self._fd, data[: select.PIPE_BUF]) :]
                    self._is_cut_off = bool(data)
        except OSError as error:
            if error.errno in DISK_FULL:
                self._items.dropped += 1
            else:
                self._abandoned.set()
                self._on_gone()
