"""Remembers which retained messages a configuration has on its brokers, so that a later start can clear them.

A broker keeps a retained message for ever: after a pad was renamed, its old state and its entity in Home
Assistant would stay. A file in the state folder names the topics, and the broker with what it takes to reach
it again. Each configuration file has its own, because other daemons of this computer must not clear them.
Once a configuration file is gone, the next daemon takes over what is remembered of it.
"""

import hashlib
import logging
import threading
from collections.abc import Iterable, Iterator
from contextlib import suppress
from pathlib import Path

import msgspec

from touchd.daemon.bridges.settings import MEMORY_FILES, MqttSettings
from touchd.drivers.whole_file import PRIVATE_MODE, whole_file, without_waiting

log = logging.getLogger(__name__)

# More than one daemon ever needs; the oldest beyond are forgotten.
MOST_TOPICS, MOST_BROKERS = 256, 16


def topics_of(settings: MqttSettings, pad: str) -> list[str]:
    """Return the topics of a pad's retained messages: its state and, if announced, its announcement."""
    topic = f"{settings.topic}/{pad}"
    if settings.discovery is None:
        return [f"{topic}/state"]
    return [f"{topic}/state", f"{settings.discovery}/event/{entity_of(topic)}/config"]


def entity_of(topic: str) -> str:
    """Return the name in Home Assistant of what has this topic."""
    return topic.replace("/", "_")


class OnBroker(msgspec.Struct, frozen=True):
    """Topics that have retained messages on a broker."""

    broker: MqttSettings
    topics: tuple[str, ...]

    @property
    def address(self) -> tuple[str, int]:
        return self.broker.host, self.broker.port

    def without(self, others: Iterable["OnBroker"]) -> "OnBroker":
        """Return the same without the topics that others have on this broker."""
        theirs = {topic for other in others if other.address == self.address for topic in other.topics}
        return OnBroker(self.broker, tuple(topic for topic in self.topics if topic not in theirs))


class Memory(msgspec.Struct, frozen=True):
    """The content of a file. config: the path of the configuration file that it belongs to."""

    config: str
    brokers: tuple[OnBroker, ...] = ()


class Retained:
    """The retained topics of a daemon. Thread-safe.

    folder: for state. present: those of the present configuration, None without a broker. They are remembered
    from the first connection on: an address that never was a broker's has nothing to clear.
    former: those that an earlier configuration left, by broker, to be cleared.
    """

    def __init__(self, folder: Path, config: Path, present: OnBroker | None) -> None:
        self._file = file_for(config, folder)
        self._config = str(config.resolve())
        self._present = present
        self._lock = threading.Lock()
        others = {file: memory for file, memory in _memories(folder) if file != self._file}
        gone = {file: memory for file, memory in others.items() if not _exists(memory.config)}
        living = [on for file, memory in others.items() if file not in gone for on in memory.brokers]
        remembered = [*(on for memory in gone.values() for on in memory.brokers), *_read(self._file).brokers]
        now = [present] if present is not None else []
        # A broker that is used now is reached as now: its login may have changed.
        before = _merged([*remembered, *(OnBroker(on.broker, ()) for on in now)])
        self.former = tuple(left for on in before if (left := on.without([*living, *now])).topics)
        self._held = _common(remembered, present) if present is not None else ()
        self._write()
        for file in gone:
            with suppress(OSError):
                file.unlink()

    def reached(self) -> None:
        """Note that the present broker is there; call it before anything is published, in case of a kill."""
        with self._lock:
            if self._present is not None and self._held != (self._present,):
                self._held = (self._present,)
                self._write()

    def cleared(self, cleared: OnBroker) -> None:
        """Note that a broker no longer has these topics."""
        with self._lock:
            self.former = tuple(left for on in self.former if (left := on.without([cleared])).topics)
            self._write()

    def _write(self) -> None:
        brokers = _merged([*self.former, *self._held])
        try:
            if not brokers:
                self._file.unlink(missing_ok=True)
                return
            self._file.parent.mkdir(mode=0o700, parents=True, exist_ok=True)
            with whole_file(self._file, mode=PRIVATE_MODE) as new:
                new.write_bytes(msgspec.json.encode(Memory(self._config, brokers)))
        # A path that is not UTF-8 cannot be written.
        except (OSError, UnicodeEncodeError) as error:
            log.info("what a later configuration should clear at the broker is not remembered: %s", error)


def file_for(config: Path, folder: Path) -> Path:
    """Return the file in a state folder that belongs to a configuration file."""
    name = str(config.resolve()).encode(errors="surrogateescape")
    return folder / MEMORY_FILES.replace("*", hashlib.sha256(name).hexdigest()[:16])


def _common(remembered: Iterable[OnBroker], present: OnBroker) -> tuple[OnBroker, ...]:
    """Return what is both present and remembered, to be reached as at present."""
    before = {topic for on in remembered if on.address == present.address for topic in on.topics}
    topics = tuple(topic for topic in present.topics if topic in before)
    return (OnBroker(present.broker, topics),) if topics else ()


def _merged(brokers: Iterable[OnBroker]) -> tuple[OnBroker, ...]:
    """Return one entry for each broker, with the newest settings and the newest topics up to the limit."""
    merged: dict[tuple[str, int], OnBroker] = {}
    for on in brokers:
        before = merged.pop(on.address, None)
        topics = dict.fromkeys([*(before.topics if before is not None else ()), *on.topics])
        merged[on.address] = OnBroker(on.broker, tuple(topics)[-MOST_TOPICS:])
    return tuple(merged.values())[-MOST_BROKERS:]


def _memories(folder: Path) -> Iterator[tuple[Path, Memory]]:
    with suppress(OSError):
        for file in sorted(folder.glob(MEMORY_FILES)):
            yield file, _read(file)


def _exists(config: str) -> bool:
    """Whether a configuration file is there; one that cannot be looked for counts as there."""
    try:
        Path(config).stat()
    except (FileNotFoundError, NotADirectoryError):
        return False
    except (OSError, ValueError):
        return True
    return True


def _read(file: Path) -> Memory:
    # A missing or damaged file is an empty one.
    with suppress(OSError, msgspec.DecodeError), open(file, "rb", opener=without_waiting) as opened:
        return msgspec.json.decode(opened.read(), type=Memory)
    return Memory(config="")
