"""The few NAOqi services that touchd uses, in plain Python: they record the calls and do nothing else."""

import struct
import time
from collections.abc import Callable, Collection, Sequence

import msgspec


class Call(msgspec.Struct, frozen=True, kw_only=True, omit_defaults=True):
    """One call to the robot. refused: why it failed, empty if it succeeded.

    time_s: seconds since 1970, at the robot. arguments: as the robot keeps them, after coercion.
    """

    service: str
    method: str
    arguments: tuple[object, ...]
    time_s: float
    refused: str = ""


def as_kept(value: object) -> object:
    """Return a value as ALMemory keeps it; raises ValueError for what it cannot hold.

    ALMemory's integers and floats have four bytes: larger integers are refused, floats lose precision.
    """
    if isinstance(value, (bool, str)):
        return value
    if isinstance(value, int):
        if not -(2**31) <= value < 2**31:
            raise ValueError(f"{value} does not fit in 4 bytes")
        return value
    if isinstance(value, float):
        try:
            return struct.unpack("<f", struct.pack("<f", value))[0]
        except OverflowError as error:
            raise ValueError(f"{value} does not fit in 4 bytes") from error
    if isinstance(value, Sequence):
        return [as_kept(part) for part in value]
    raise ValueError(f"ALMemory holds no {type(value).__name__}")


class _Service:
    """A service with NAOqi's name that records its calls; each takes call_s seconds."""

    def __init__(self, note: Callable[[Call], None], call_s: float) -> None:
        self._note_call = note
        self._call_s = call_s

    def _note(self, method: str, *arguments: object, why: str = "") -> None:
        service = type(self).__name__
        self._note_call(
            Call(service=service, method=method, arguments=arguments, time_s=time.time(), refused=why)
        )
        time.sleep(0.0 if why else self._call_s)

    def _refuse(self, method: str, arguments: tuple[object, ...], why: str) -> RuntimeError:
        self._note(method, *map(str, arguments), why=why)
        return RuntimeError(f"{type(self).__name__}.{method}: {why}")


class ALMemory(_Service):
    """Events and data by key."""

    def __init__(self, note: Callable[[Call], None], call_s: float) -> None:
        super().__init__(note, call_s)
        self._data: dict[str, object] = {}

    def raiseEvent(self, key: str, value: object) -> None:  # noqa: N802 - NAOqi's names, here and below
        """Store a value; nobody subscribes to it here."""
        try:
            kept = as_kept(value)
        except ValueError as error:
            raise self._refuse("raiseEvent", (key, value), str(error)) from error
        self._data[key] = kept
        self._note("raiseEvent", key, kept)

    def getData(self, key: str) -> object:  # noqa: N802
        if key not in self._data:
            raise self._refuse("getData", (key,), f"no data named {key}")
        return self._data[key]

    def removeData(self, key: str) -> None:  # noqa: N802
        if self._data.pop(key, None) is None:
            raise self._refuse("removeData", (key,), f"no data named {key}")
        self._note("removeData", key)


class ALTextToSpeech(_Service):
    """A call lasts as long as the speech."""

    def say(self, text: str) -> None:
        self._note("say", text)


class ALAnimatedSpeech(ALTextToSpeech):
    """Speech with gestures."""


class ALBehaviorManager(_Service):
    """Behaviours are installed when their name looks like a path."""

    def runBehavior(self, behavior: str) -> None:  # noqa: N802
        if "/" not in behavior:
            raise self._refuse("runBehavior", (behavior,), f"no behavior named {behavior}")
        self._note("runBehavior", behavior)


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


SPEECH = (ALTextToSpeech, ALAnimatedSpeech)
OTHERS = (ALMemory, ALBehaviorManager, ALLeds, ALSystem)
SERVICE_NAMES = tuple(sorted(kind.__name__ for kind in (*OTHERS, *SPEECH)))


def fake_services(
    note: Callable[[Call], None], *, call_s: float = 0.0, say_s: float = 0.0, without: Collection[str] = ()
) -> dict[str, object]:
    """Return the services by name, without some. call_s, say_s: seconds that a call, and speech, takes."""
    services = [*(kind(note, call_s) for kind in OTHERS), *(kind(note, say_s) for kind in SPEECH)]
    named = {type(service).__name__: service for service in services}
    return {name: service for name, service in named.items() if name not in without}
