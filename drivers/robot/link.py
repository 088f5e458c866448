"""The link to a Nao over qi: answers become events in its memory and, if configured, actions.

The daemon never waits for the robot, whether it is away, hangs or refuses.
"""

import atexit
import logging
import re
import threading
import time
from abc import ABC, abstractmethod
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import closing, suppress
from typing import Generic, Literal, TypeAlias, TypeVar

from touchd.drivers.faults import Backoff, FaultLog
from touchd.drivers.frame import DEFAULT_PAD
from touchd.drivers.queue import DroppingQueue, Signal
from touchd.drivers.robot.reactions import (
    Action,
    ActionRule,
    Kind,
    Reaction,
    Reactions,
    RobotMessage,
    Words,
    spoken,
)
from touchd.drivers.robot.session import (
    OpenSession,
    QiSession,
    RobotLimits,
    RobotLost,
    RobotRefused,
    RobotSession,
    RobotSettings,
    load_qi,
    read_login,
)

log = logging.getLogger(__name__)

Item = TypeVar("Item")
LinkState: TypeAlias = Literal["up", "down"]

# Poll interval for an idle connection; bounds how long a killed robot goes unnoticed.
LOOK_S = 0.05
# Time to drain the queue on shutdown.
LAST_WORDS_S = 0.5
# How long PREFIX/Gesture stays in the robot's memory, as its own ALTactileGesture does.
SHOWN_S = 1.0
NO_ACTIONS: Mapping[str, Sequence[ActionRule]] = {DEFAULT_PAD: ()}
NO_WORDS: Mapping[str, Words] = {}


class RobotLink:
    """Sends answers to a robot and has it react to them.

    Two workers, each with a session of its own: one raises events; the other, only if there are actions, has
    the robot speak, move and shine, which takes seconds and must not delay an event.
    settings: checked here; raises RobotError with one line when the user must change something.
    on_state: called from a worker's thread when the robot comes ("up", "") or goes ("down", why).
    open_session: how to reach the robot; real qi by default.
    on_act: called from a worker's thread when the robot begins to speak, move or shine, with what and how.
    actions: what the robot does on an answer, for each pad. words: of the gestures, for what it says.
    """

    def __init__(
        self,
        settings: RobotSettings,
        on_state: Callable[[LinkState, str], None] | None = None,
        open_session: OpenSession | None = None,
        on_act: Callable[[RobotMessage, Kind, str], None] | None = None,
        *,
        actions: Mapping[str, Sequence[ActionRule]] = NO_ACTIONS,
        words: Mapping[str, Words] = NO_WORDS,
        limits: RobotLimits | None = None,
    ) -> None:
        self._settings, self._login = settings, read_login(settings)
        if open_session is None:
            load_qi()
        self._open_session = open_session or QiSession
        self._limits = limits or RobotLimits()
        self._on_state = on_state or (lambda *_: None)
        self._state: LinkState | None = None
        self._faults = FaultLog(log)
        self._events = _EventWorker(settings.prefix, actions, self._open, self._limits, self._note_state)
        self._reactions = {pad: Reactions(own) for pad, own in actions.items()}
        self._actions: _ReactionWorker | None = None
        self._workers: list[_EventWorker | _ReactionWorker] = [self._events]
        if any(actions.values()):
            self._actions = _ReactionWorker(words, on_act or (lambda *_: None), self._open, self._limits)
            self._workers.append(self._actions)

    @property
    def counts(self) -> Counter[str]:
        """What became of the messages published."""
        return self._events.counts

    def start(self) -> None:
        """Begin to connect; returns at once, and the link keeps trying until it is stopped."""
        # A Python that exits while a thread is inside libqi crashes, which would hide why it exits.
        atexit.register(self.stop)
        for worker in self._workers:
            worker.start()

    def publish(self, message: RobotMessage, *, is_told: bool = True) -> None:
        """Act on an answer, and send it to the robot if `is_told`. Never waits; call it from one thread."""
        if is_told:
            self._events.put(message)
        reaction = self._reactions[message.pad].choose(message, time.monotonic(), is_told=is_told)
        if reaction is not None and self._actions is not None:
            self._actions.put(reaction)

    def set_status(self, status: str, pad: str = DEFAULT_PAD) -> None:
        """Send the robot a pad's state: "up", "degraded" or "down". Never waits."""
        self._events.set_status(status, pad)

    def stop(self, timeout_s: float = 2.0) -> None:
        """Say goodbye to the robot and end, in whatever state it is; may be called again."""
        deadline_s = time.monotonic() + timeout_s
        for worker in self._workers:
            worker.ask_to_stop()
        for worker in self._workers:
            if not worker.join(max(0.0, deadline_s - time.monotonic())):
                log.warning("the link to the robot did not end within %g s", timeout_s)
        atexit.unregister(self.stop)

    def _open(self, stopping: threading.Event) -> RobotSession:
        return self._open_session(self._settings.url, self._login, self._limits, stopping)

    def _note_state(self, state: LinkState, reason: str) -> None:
        """Log that the robot is there, or that an attempt to reach it failed; report a change."""
        url = self._settings.url
        if state == "down":
            what = f"robot {url} is down ({reason}); trying until it is there"
            # Durations in a reason differ from one attempt to the next.
            self._faults.begin("down", what, cause=re.sub(r"[\d.]+", "", reason))
        elif self._state is None:
            log.info("robot %s is up", url)
        else:
            self._faults.end("down", f"robot {url} is up again")
        if state == self._state:
            return
        self._state = state
        try:
            self._on_state(state, reason)
        except Exception:
            log.exception("the state of the robot could not be reported")


class _Worker(ABC, Generic[Item]):
    """A thread that keeps a session with the robot and sends what a bounded queue holds.

    The thread alone uses the session. `begin`, `handle`, `tend` and `end` may raise RobotLost or
    RobotRefused.
    open_session: returns a new, unconnected session, given the event that says to hurry.
    on_state: called after each attempt to connect and each loss, from the worker's thread.
    counts: what became of the items; queued = sent + dropped (the queue was full) + stale (waited too long)
    + failed (refused, or the robot was lost during the call; not repeated, since it may have been carried
    out) + those still waiting.
    """

    def __init__(
        self,
        name: str,
        open_session: Callable[[threading.Event], RobotSession],
        limits: RobotLimits,
        on_state: Callable[[LinkState, str], None] = lambda *_: None,
    ) -> None:
        self._open_session = open_session
        self._limits = limits
        self._on_state = on_state
        self._faults = FaultLog(log)
        self._wake = Signal()
        self._queue: DroppingQueue[tuple[float, Item]] = DroppingQueue(limits.capacity, filled=self._wake)
        self._counts: Counter[str] = Counter()
        self._backoff = Backoff(limits.backoff_first_s, limits.backoff_cap_s)
        self._stopping = threading.Event()
        self._thread = threading.Thread(target=self._run, name=name, daemon=True)

    @abstractmethod
    def handle(self, session: RobotSession, item: Item) -> None:
        """Do what a queued item asks for."""

    def begin(self, session: RobotSession) -> None:
        """Make the first calls on a new session, if any."""

    def tend(self, session: RobotSession) -> bool:
        """Do what is due apart from the queue; returns whether the robot was called."""
        return False

    def end(self, session: RobotSession) -> None:
        """Leave the robot tidy before the session is given up."""

    @property
    def counts(self) -> Counter[str]:
        return self._counts + Counter(dropped=self._queue.dropped)

    def start(self) -> None:
        self._thread.start()

    def put(self, item: Item) -> None:
        """Queue an item and return at once; call it from one thread."""
        self._counts["queued"] += 1
        self._queue.put((time.monotonic(), item))

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
                    self._note("up", "")
                    self._serve(session)
                    self.end(session)
            except (RobotLost, RobotRefused) as error:
                self._note("down", str(error))
            except Exception as error:
                # Retry after any error: a link that ends without a word needs a restart to come back.
                log.exception("internal error in the link to the robot")
                self._note("down", f"{type(error).__name__}: {error}")
            self._stopping.wait(self._backoff.pause_s())

    def _note(self, state: LinkState, reason: str) -> None:
        if not self._stopping.is_set():
            self._on_state(state, reason)

    def _serve(self, session: RobotSession) -> None:
        """Send until asked to stop, then what is left; raises RobotLost when the robot is gone."""
        answered_s = time.monotonic()
        while not self._stopping.is_set():
            if not session.connected():
                raise RobotLost("the connection was closed by the robot")
            if self.tend(session) or self._handle_next(session):
                answered_s = time.monotonic()
            elif time.monotonic() - answered_s >= self._limits.heartbeat_s:
                self._heartbeat(session)
                answered_s = time.monotonic()
            else:
                self._wake.wait(LOOK_S)
        deadline_s = time.monotonic() + LAST_WORDS_S
        while time.monotonic() < deadline_s and self._handle_next(session):
            pass

    def _heartbeat(self, session: RobotSession) -> None:
        # An error is an answer too: only silence means that the robot hangs.
        with suppress(RobotRefused):
            session.call("ALSystem", "systemVersion", limit_s=self._limits.call_s)

    def _handle_next(self, session: RobotSession) -> bool:
        """Handle the oldest item that is not stale; returns whether the robot was called."""
        oldest_s = time.monotonic() - self._limits.stale_s
        while (entry := self._queue.get_nowait()) is not None and entry[0] < oldest_s:
            self._counts["stale"] += 1
        if entry is None:
            return False
        became = "failed"
        try:
            self.handle(session, entry[1])
            became = "sent"
            self._faults.end("refused", "the robot does as asked again")
        except RobotRefused as refused:
            self._faults.begin("refused", f"the robot refused {refused}")
        finally:
            self._counts[became] += 1
        return True


class _EventWorker(_Worker[RobotMessage]):
    """Raises PREFIX/Detail and PREFIX/Gesture for each answer, and PREFIX/Status when it changes.

    A pad with a name has its own, PREFIX/NAME/Gesture and so on. The Gesture is a plain string that is
    removed from the robot's memory after SHOWN_S, as the robot's own ALTactileGesture is. The Detail
    is raised first, so that a program that wakes on the Gesture finds the Detail that belongs to it.
    """

    def __init__(
        self,
        prefix: str,
        pads: Iterable[str],
        open_session: Callable[[threading.Event], RobotSession],
        limits: RobotLimits,
        on_state: Callable[[LinkState, str], None],
    ) -> None:
        super().__init__("touchd-robot", open_session, limits, on_state)
        self._prefix = prefix
        self._remove_at_s: dict[str, float] = {}
        self._sent_status: dict[str, str] = {}
        # Written by another thread, read here; replacing a value is atomic.
        self._status: dict[str, str] = dict.fromkeys(pads, "up")

    def set_status(self, status: str, pad: str) -> None:
        """Send a pad's status now; call it from any thread."""
        self._status[pad] = status
        self._wake.set()

    def begin(self, session: RobotSession) -> None:
        for pad, status in self._status.items():
            self._send_status(session, pad, status)

    def handle(self, session: RobotSession, item: RobotMessage) -> None:
        self._raise(session, self._name(item.pad, "Detail"), _detail(item))
        self._raise(session, self._name(item.pad, "Gesture"), str(item.gesture))
        self._remove_at_s[item.pad] = time.monotonic() + SHOWN_S

    def tend(self, session: RobotSession) -> bool:
        """Remove a gesture when its time is over, send a status that has changed."""
        for pad, remove_at_s in self._remove_at_s.items():
            if time.monotonic() >= remove_at_s:
                self._remove(session, pad)
                return True
        for pad, status in self._status.items():
            if status != self._sent_status.get(pad):
                self._send_status(session, pad, status)
                return True
        return False

    def end(self, session: RobotSession) -> None:
        """Remove gestures, and set every pad's status to down."""
        for pad in list(self._remove_at_s):
            self._remove(session, pad)
        for pad in self._status:
            self._send_status(session, pad, "down")

    def _name(self, pad: str, event: str) -> str:
        return f"{self._prefix}/{event}" if pad == DEFAULT_PAD else f"{self._prefix}/{pad}/{event}"

    def _send_status(self, session: RobotSession, pad: str, status: str) -> None:
        self._raise(session, self._name(pad, "Status"), status)
        self._sent_status[pad] = status

    def _remove(self, session: RobotSession, pad: str) -> None:
        # Another program may have removed it, and a robot that has restarted has forgotten it.
        with suppress(RobotRefused):
            gesture = self._name(pad, "Gesture")
            session.call("ALMemory", "removeData", gesture, limit_s=self._limits.call_s)
        del self._remove_at_s[pad]

    def _raise(self, session: RobotSession, event: str, value: object) -> None:
        session.call("ALMemory", "raiseEvent", event, value, limit_s=self._limits.call_s)


class _ReactionWorker(_Worker[Reaction]):
    """Carries reactions out, one action after the other, each to its end.

    words: of the gestures, for speech. on_act: called as an action begins, with its words or name.
    """

    def __init__(
        self,
        words: Mapping[str, Words],
        on_act: Callable[[RobotMessage, Kind, str], None],
        open_session: Callable[[threading.Event], RobotSession],
        limits: RobotLimits,
    ) -> None:
        # The worker that raises events reports whether the robot is there.
        super().__init__("touchd-robot-actions", open_session, limits)
        self._words = words
        self._on_act = on_act

    def handle(self, session: RobotSession, item: Reaction) -> None:
        """Carry out a reaction; what the robot refuses is left out, and raised as RobotRefused at the end."""
        refused: list[RobotRefused] = []
        for left, action in zip(range(len(item.actions) - 1, -1, -1), item.actions, strict=True):
            try:
                self._perform(session, action, item.message)
            except RobotRefused as error:
                refused.append(error)
            except RobotLost as lost:
                log.warning("an action is given up, with %d after it: %s", left, lost)
                raise
        if refused:
            raise RobotRefused("; ".join(map(str, refused)))

    def _perform(self, session: RobotSession, action: Action, message: RobotMessage) -> None:
        """Have the robot do one action and wait for its end; raises RobotLost or RobotRefused."""

        def call(kind: Kind, what: str, service: str, method: str, *arguments: object) -> None:
            self._on_act(message, kind, what)
            session.call(service, method, *arguments, limit_s=self._limits.action_s)

        if action.say is not None:
            words = spoken(action.say, message.gesture, message.confidence, self._words)
            call("say", words, "ALTextToSpeech", "say", words)
        elif action.animated_say is not None:
            words = spoken(action.animated_say, message.gesture, message.confidence, self._words)
            call("animated_say", words, "ALAnimatedSpeech", "say", words)
        elif action.behavior is not None:
            call("behavior", action.behavior, "ALBehaviorManager", "runBehavior", action.behavior)
        elif action.leds is not None:
            leds = action.leds
            call("leds", leds.color, "ALLeds", "fadeRGB", leds.group, leds.rgb, leds.fade_s)


def _detail(message: RobotMessage) -> list[object]:
    """Return [gesture, confidence, [seconds, microseconds], stage, touch, sequence] in builtin types.

    ALMemory holds 4-byte integers and floats. As a float an epoch time would have a resolution of 128 s, so
    it is sent as two integers. Integers wrap at 2**31.
    """
    seconds, microseconds = divmod(round(float(message.time_s) * 1_000_000), 1_000_000)
    return [
        str(message.gesture),
        float(message.confidence),
        [_int32(seconds), microseconds],
        str(message.stage),
        _int32(message.touch),
        _int32(message.sequence),
    ]


def _int32(number: int) -> int:
    return int(number) & 0x7FFF_FFFF
