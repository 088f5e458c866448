"""The daemon in a separate process, for the demo, the bench and end-to-end tests."""

import os
import subprocess
import sys
from collections.abc import Callable, Iterator, Mapping
from functools import partial
from pathlib import Path
from typing import IO

import msgspec
import yaml

from touchd.daemon.app.config import SensorSettings, Settings
from touchd.daemon.path.events import Event
from touchd.daemon.sinks.touches import decode
from touchd.drivers.fakes.encode import encode_frame
from touchd.drivers.frame import Counts

STOP_S = 10.0


class SpawnedDaemon:
    """`touchd run` in a separate process, with its own configuration file.

    folder: where the configuration goes. log: its standard error, ours by default. environment: added to
    ours.
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
            [sys.executable, "-m", "touchd.daemon", "run", "-c", str(path)],
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
        """Send SIGTERM, wait, and return the exit code; may be repeated."""
        # Leaving this block closes the pipe.
        with self.process:
            self.process.terminate()
            try:
                return self.process.wait(STOP_S)
            except subprocess.TimeoutExpired:
                self.process.kill()
                return self.process.wait()


def encoder_for(sensor: SensorSettings) -> Callable[[Counts, int], bytes]:
    """Return an encoder from counts (8, 8) and the sensor's clock in ms to the pad's bytes."""
    return partial(encode_frame, sensor.described)
