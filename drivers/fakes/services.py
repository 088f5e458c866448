"""The few NAOqi services that touchd uses, in plain Python: they record the calls and do nothing else."""

import struct
import time
from collections.abc import Callable, Collection, Mapping, Sequence

import msgspec


class Call(msgspec.Struct, frozen=True, kw_only=True, omit_defaults=True):
    """One call to the robot. refused: why it failed, empty if it succeeded.

    time_s: seconds since 1970, at the robot. arguments: as the robot stores them, after coercion.
    """

    service: str
    method: str
    arguments: tuple[object, ...]
    time_s: float
    refused: str = ""


def as_stored(value: object) -> object:
    """Return a value as ALMemory stores it, numbers in four bytes; raises ValueError if it does not fit."""
    if isinstance(value, bool | str):
        return value
    if isinstance(value, int | float):
        kind = struct.Struct("<f" if isinstance(value, float) else "<i")
        try:
            return kind.unpack(kind.pack(value))[0]
        except (struct.error, OverflowError) as error:
            raise ValueError(f"{value} does not fit in 4 bytes") from error
    if isinstance(value, Sequence):
        return [as_stored(part) for part in value]
    raise ValueError(f"ALMemory holds no {type(value).__name__}")


class _Service:
    """A service with NAOqi's name that records its calls; each takes call_s seconds."""

    def __init__(self, note: Callable[[Call], None], call_s: float) -> None:
        self._note_call, self._call_s = note, call_s

    def _note(self, method: str, *arguments: object, refused: str = "") -> None:
        """Record a call and wait for as long as it takes; raises RuntimeError if it is refused."""
        name, now_s = type(self).__name__, time.time()
        call = Call(service=name, method=method, arguments=arguments, time_s=now_s, refused=refused)
        self._note_call(call)
        if refused:
            raise RuntimeError(f"{name}.{method}: {refused}")
        time.sleep(self._call_s)


class ALMemory(_Service):
    """Events and data by key."""

    def __init__(self, note: Callable[[Call], None], call_s: float) -> None:
        super().__init__(note, call_s)
        self._data: dict[str, object] = {}

    def raiseEvent(self, key: str, value: object) -> None:  # noqa: N802 - NAOqi's names, here and below
        """Store a value; nobody subscribes to it here."""
        refused = ""
        try:
            self._data[key] = value = as_stored(value)
        except ValueError as error:
            refused = str(error)
        self._note("raiseEvent", key, value, refused=refused)

    def getData(self, key: str) -> object:  # noqa: N802
        if key not in self._data:
            self._note("getData", key, refused=f"no data named {key}")
        return self._data[key]

    def removeData(self, key: str) -> None:  # noqa: N802
        there = self._data.pop(key, None) is not None
        self._note("removeData", key, refused="" if there else f"no data named {key}")


class ALTextToSpeech(_Service):
    """A call lasts as long as the speech."""

    def say(self, text: str) -> None:
        self._note("say", text)


class ALAnimatedSpeech(ALTextToSpeech):
    """Speech with gestures."""


class ALBehaviorManager(_Service):
    """Behaviours are installed when their name looks like a path."""

    def runBehavior(self, behavior: str) -> None:  # noqa: N802
        refused = "" if "/" in behavior else f"no behavior named {behavior}"
        self._note("runBehavior", behavior, refused=refused)


class ALLeds(_Service):
    """Coloured lights."""

    def fadeRGB(self, group: str, rgb: int, duration_s: float) -> None:  # noqa: N802
        self._note("fadeRGB", group, rgb, duration_s)


class ALSystem(_Service):
    """The heartbeat's service; its calls are not recorded."""

    def systemVersion(self) -> str:  # noqa: N802
        """Return the version that a NAO V6 runs."""
        time.sleep(self._call_s)
        return "2.8.7.4"


KINDS = (ALAnimatedSpeech, ALBehaviorManager, ALLeds, ALMemory, ALSystem, ALTextToSpeech)
SERVICES: Mapping[str, type[_Service]] = {kind.__name__: kind for kind in KINDS}


def fake_services(
    note: Callable[[Call], None], *, call_s: float = 0.0, say_s: float = 0.0, without: Collection[str] = ()
) -> dict[str, object]:
    """Return the services by name, without some. call_s, say_s: seconds that a call, and speech, takes."""
    return {
        name: kind(note, say_s if issubclass(kind, ALTextToSpeech) else call_s)
        for name, kind in SERVICES.items()
        if name not in without
    }
