"""The real daemon on a fake pad: what the demo shows, the bench measures and the end-to-end tests try."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import IO

import msgspec
import yaml

from daemon.config import Settings
from daemon.events import Event, Prediction, TouchBegan, TouchEnded, decode

STOP_S = 10.0
OUTLINE: Mapping[type, tuple[str, ...]] = {
    TouchBegan: ("touch",),
    Prediction: ("touch", "stage", "gesture", "changed", "told", "degraded"),
    TouchEnded: ("touch", "gesture", "reason"),
}


class SpawnedDaemon:
    """`touchd run` in a process of its own, on a configuration written for it.

    folder: where the configuration goes. log: gets what it writes to standard error, ours when left out.
    environment: what to add to ours.
    """

    def __init__(
        self,
        settings: Settings,
        folder: Path,
        log: IO[bytes] | None = None,
        environment: Mapping[str, str] | None = None,
    ) -> None:
        path = folder / "touchd.yaml"
        path.write_text(yaml.safe_dump(msgspec.to_builtins(settings)))
        self.process = subprocess.Popen(
            [sys.executable, "-m", "daemon", "run", "-c", str(path)],
            stdout=subprocess.PIPE,
            stderr=log,
            env={**os.environ, **(environment or {})},
        )

    def events(self) -> Iterator[Event]:
        """Yield events until the daemon has ended."""
        assert self.process.stdout is not None
        for line in self.process.stdout:
            yield decode(line)

    def stop(self) -> int:
        """Ask it to end (SIGTERM), wait, and return its exit code; may be called again."""
        if self.process.poll() is None:
            self.process.terminate()
        try:
            return self.process.wait(STOP_S)
        except subprocess.TimeoutExpired:
            self.process.kill()
            return self.process.wait()
        finally:
            if self.process.stdout is not None:
                self.process.stdout.close()


def outline(events: Iterable[Event]) -> list[dict[str, object]]:
    """Return what is said of a stream however it is played: touches and answers, without their figures."""
    return [
        {"type": event.__struct_config__.tag, **{name: getattr(event, name) for name in OUTLINE[type(event)]}}
        for event in events
        if type(event) in OUTLINE
    ]
