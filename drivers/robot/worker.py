"""A worker of the link to the robot: a thread that keeps a session and does what waits in its queue."""

import logging
import threading
import time
from collections.abc import Callable
from contextlib import closing, suppress
from typing import Literal, TypeAlias

from touchd.drivers.faults import Backoff, FaultLog
from touchd.drivers.queue import DroppingQueue, Signal
from touchd.drivers.robot.session import RobotLimits, RobotLost, RobotRefused, RobotSession

log = logging.getLogger(__name__)

LinkState: TypeAlias = Literal["up", "down"]
Task: TypeAlias = Callable[[RobotSession], None]

# Poll interval for an idle connection; bounds how long a killed robot goes unnoticed.
IDLE_S = 0.05
# Time to drain the queue on shutdown.
LAST_WORDS_S = 0.5


class Worker:
    """A thread that keeps a session with the robot and carries out the tasks that a bounded queue holds.

    The thread alone uses the session. Tasks, `begin`, `tend`, `ask` and `end` may raise RobotLost or
    RobotRefused.
    open_session: returns a new, unconnected session, given the event that is set once the daemon stops.
    A task is dropped if the queue is full or it waited too long. One that was refused, or during which the
    robot was lost, is not repeated, since it may have been carried out.
    """

    def __init__(
        self, name: str, open_session: Callable[[threading.Event], RobotSession], limits: RobotLimits
    ) -> None:
        self._open_session = open_session
        self._limits = limits
        self._faults = FaultLog(log)
        self._wake = Signal()
        self._queue: DroppingQueue[tuple[float, Task]] = DroppingQueue(limits.capacity, filled=self._wake)
        self._backoff = Backoff(first_s=0.1, cap_s=1.0)
        self._stopping = threading.Event()
        self._thread = threading.Thread(target=self._run, name=name, daemon=True)

    def note_state(self, state: LinkState, reason: str) -> None:
        """Note the result of an attempt to connect, or a loss; called from the worker's thread."""

    def begin(self, session: RobotSession) -> None:
        """Make the first calls on a new session, if any."""

    def tend(self, session: RobotSession) -> bool:
        """Do what is due beside the queue; returns whether the robot was called."""
        return False

    def ask(self, session: RobotSession) -> None:
        """Ask an idle robot something, to notice that it hangs."""
        session.call("ALSystem", "systemVersion", limit_s=self._limits.call_s)

    def end(self, session: RobotSession) -> None:
        """Clean up on the robot before the session is closed."""

    def start(self) -> None:
        self._thread.start()

    def do(self, task: Task) -> None:
        """Queue a task and return at once; call it from one thread."""
        self._queue.put((time.monotonic(), task))

    def ask_to_stop(self) -> None:
        """Tell the worker to end; returns at once."""
        self._stopping.set()
        self._wake.set()

    def join(self, timeout_s: float) -> bool:
        if self._thread.ident is not None:
            self._thread.join(timeout_s)
        return not self._thread.is_alive()

    def _run(self) -> None:
        while not self._stopping.is_set():
            try:
                with closing(self._open_session(self._stopping)) as session:
                    session.connect()
                    self.begin(session)
                    # The first call also resolves the service, so make it before the hang timeout applies.
                    self._heartbeat(session)
                    self._backoff.reset()
                    self.note_state("up", "")
                    self._serve(session)
                    self.end(session)
            except (RobotLost, RobotRefused) as error:
                self.note_state("down", str(error))
            except Exception as error:
                # Retry after any error: a dead worker would not come back until the daemon is restarted.
                log.exception("internal error in the link to the robot")
                self.note_state("down", f"{type(error).__name__}: {error}")
            self._stopping.wait(self._backoff.pause_s())

    def _serve(self, session: RobotSession) -> None:
        """Work until asked to stop, then do what is left; raises RobotLost when the robot is gone."""
        answered_s = time.monotonic()
        while not self._stopping.is_set():
            if not session.connected():
                raise RobotLost("the connection was closed by the robot")
            if self.tend(session) or self._do_next(session):
                answered_s = time.monotonic()
            elif time.monotonic() - answered_s >= self._limits.heartbeat_s:
                self._heartbeat(session)
                answered_s = time.monotonic()
            else:
                self._wake.wait(IDLE_S)
        deadline_s = time.monotonic() + LAST_WORDS_S
        while time.monotonic() < deadline_s and self._do_next(session):
            pass

    def _heartbeat(self, session: RobotSession) -> None:
        # An error is an answer too: only silence means that the robot hangs.
        with suppress(RobotRefused):
            self.ask(session)

    def _do_next(self, session: RobotSession) -> bool:
        """Do the oldest task that is not stale; returns whether there was one."""
        oldest_s = time.monotonic() - self._limits.stale_s
        while (entry := self._queue.get_nowait()) is not None and entry[0] < oldest_s:
            pass
        if entry is None:
            return False
        try:
            entry[1](session)
            self._faults.end("refused", "the robot does as asked again")
        except RobotRefused as refused:
            self._faults.begin("refused", f"the robot refused {refused}")
        return True
