"""Remembers which retained messages a configuration has on its broker, so that a later one can clear them.

A broker keeps a retained message for ever: after a pad was renamed, its old state and its entity in Home
Assistant would stay. The topics are in a file of the state folder, one for each configuration file, because
another daemon of this computer must not clear them.
"""

import hashlib
import logging
from collections.abc import Iterable
from contextlib import suppress
from pathlib import Path

import msgspec

from touchd.drivers.whole_file import PRIVATE_MODE, whole_file, without_waiting

log = logging.getLogger(__name__)

# More than one daemon ever needs; the oldest beyond are forgotten.
MOST_TOPICS, MOST_BROKERS = 256, 16


class Retained:
    """The retained topics of a daemon on its broker.

    file: where they are remembered. broker: its address. topics: those of the present configuration.
    former: those that an earlier configuration left there.
    """

    def __init__(self, file: Path, broker: str, topics: Iterable[str]) -> None:
        self._file = file
        self._broker = broker
        self._topics = list(topics)
        self._all = _read(file)
        self.former = [topic for topic in self._all.get(broker, ()) if topic not in self._topics]
        # Before they are published: if the daemon is killed in between, nothing is forgotten.
        self._write()

    def cleared(self, topic: str) -> None:
        """Note that the broker no longer has a former topic."""
        self.former = [left for left in self.former if left != topic]
        self._write()

    def _write(self) -> None:
        own = [*self.former, *self._topics][-MOST_TOPICS:]
        others = [(broker, topics) for broker, topics in self._all.items() if broker != self._broker]
        self._all = dict([*others, (self._broker, own)][-MOST_BROKERS:])
        try:
            self._file.parent.mkdir(mode=0o700, parents=True, exist_ok=True)
            with whole_file(self._file, mode=PRIVATE_MODE) as new:
                new.write_bytes(msgspec.json.encode(self._all))
        except OSError as error:
            log.info("what a later configuration should clear at the broker is not remembered: %s", error)


def file_for(config: Path | None, folder: Path) -> Path:
    """Return the file in a state folder that belongs to a configuration file; None: to the defaults."""
    name = str(config.resolve()) if config is not None else ""
    return folder / f"mqtt-{hashlib.sha256(name.encode(errors='surrogateescape')).hexdigest()[:16]}.json"


def _read(file: Path) -> dict[str, list[str]]:
    # A missing or damaged file is an empty one.
    with suppress(OSError, msgspec.DecodeError), open(file, "rb", opener=without_waiting) as opened:
        return msgspec.json.decode(opened.read(), type=dict[str, list[str]])
    return {}
