"""The streams and lines in tests/recordings, and what the daemon emits for each.

A stream (.csv.gz) holds frames, as `touchd record` writes them. A line (.line.gz) holds its title, the pad's
format, and a row for the bytes that arrive together: the time in ms, and the bytes in hex.

    make expectations              rebuilds the expected events
    make expectations ADD=FILE     first adds a recording as a stream

Read the diff before committing it: every changed line is a changed answer.
"""

import argparse
import gzip
import json
import logging
import shutil
import sys
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import asdict
from pathlib import Path

import msgspec
import numpy as np
from rigs.expectations import FOLDER, RECORDINGS, answers, expectation_of, outline, stream_of

from touchd.daemon.app.config import Settings
from touchd.daemon.path.events import Event, SensorEvent
from touchd.daemon.path.monitor import PadMonitor
from touchd.daemon.path.pipeline import Clock, Pipeline
from touchd.drivers.frame import CLOCK_MODULUS, Counts, Frame, SensorState
from touchd.drivers.pad.format import PadFormat
from touchd.drivers.pad.parser import FrameParser
from touchd.drivers.recording import read_recordings
from touchd.model.classifier import Classifier

LINE_SUFFIX = ".line.gz"
# The reader reports the pad as down after this much silence.
SILENCE_S = 2.0
# The pad's clock has jumped if it steps by more than this; no time has passed.
LONGEST_STEP_S = 60.0
PERIOD_S = 0.0185

Output = list[dict[str, object]]


def paths() -> list[Path]:
    """Return the streams and lines beside the shipped recordings: each a pad, a touch or a fault."""
    return sorted({*FOLDER.glob("*.csv.gz"), *FOLDER.glob(f"*{LINE_SUFFIX}")} - {*RECORDINGS})


def output_of(path: Path, classifier: Classifier) -> Output:
    """Return events, the pad's states and warnings; at the end of a line, what the parser refused."""
    if not path.name.endswith(LINE_SUFFIX):
        return Player(classifier).play(_arrivals(path))
    _, described, *pieces = gzip.decompress(path.read_bytes()).decode().splitlines()
    parser = FrameParser(msgspec.json.decode(described.removeprefix("# format: "), type=PadFormat))
    player = Player(classifier, parser)
    for piece in pieces:
        at_ms, _, data = piece.partition(",")
        if data == "reopened":
            parser.reset()
            continue
        at_s = int(at_ms) / 1000
        frames = parser.feed(bytes.fromhex(data), at_s)
        player.play([(at_s, frame) for frame in frames], ends=False)
    output = player.play(())
    refused = {name: count for name, count in asdict(parser.counts).items() if count}
    return [*output, {"type": "line", **refused}]


def _arrivals(path: Path) -> Iterator[tuple[float, Frame]]:
    """Yield a stream's frames, each when its pad sent it."""
    now_s, before_ms = 0.0, None
    for ms, counts in _frames(path):
        if before_ms is not None:
            step_s = (ms - before_ms) % CLOCK_MODULUS / 1000
            now_s += step_s if step_s <= LONGEST_STEP_S else PERIOD_S
        before_ms = ms
        yield now_s, Frame(ms, now_s, counts)


class Player:
    """Runs a pipeline in the pad's own time and keeps its output. parser: of a line, for the monitor."""

    def __init__(self, classifier: Classifier, parser: FrameParser | None = None) -> None:
        self.output: Output = []
        self._now_s = 0.0
        self._last_s: float | None = None
        clock = Clock(monotonic_s=lambda: self._now_s)
        monitor = PadMonitor(parser=parser)
        self._pipeline = Pipeline(Settings().pipeline, classifier, self._put, clock, monitor=monitor)

    def play(self, arrivals: Iterable[tuple[float, Frame]], *, ends: bool = True) -> Output:
        """Process frames as they arrive; ends: and the end of the stream. Return all output so far."""
        handler = logging.Handler(logging.WARNING)
        handler.emit = lambda record: self.output.append(  # type: ignore[method-assign]
            {"type": "log", "line": record.getMessage()}
        )
        logging.getLogger("touchd").addHandler(handler)
        try:
            for now_s, frame in arrivals:
                self._take(now_s, frame)
            if ends:
                self._pipeline.flush()
        finally:
            logging.getLogger("touchd").removeHandler(handler)
        return self.output

    def _take(self, now_s: float, frame: Frame) -> None:
        self._now_s = now_s
        if self._last_s is None or now_s - self._last_s > SILENCE_S:
            if self._last_s is not None:
                self._pipeline.on_sensor_state(SensorState("down", "no data for 2 s", "silent"))
            self._pipeline.on_sensor_state(SensorState("up", "frames arrive"))
        self._last_s = now_s
        self._pipeline.on_frame(frame)

    def _put(self, event: Event) -> None:
        if isinstance(event, SensorEvent):
            self.output.append({"type": "sensor", "state": event.state, "reason": event.reason})
        self.output.extend(outline([event]))


def _frames(path: Path) -> Iterator[tuple[int, Counts]]:
    """Yield a stream's clock and counts as the file holds them."""
    for recording in read_recordings(path):
        yield from zip(recording.sensor_ms.tolist(), recording.counts.astype(np.uint16), strict=True)


def main(arguments: Sequence[str]) -> None:
    """Rebuild the expected events, if asked after adding a recording."""
    parser = argparse.ArgumentParser(description=main.__doc__)
    parser.add_argument("--add", type=Path, metavar="FILE", help="a recording (.csv.gz) to add as a stream")
    if added := parser.parse_args(arguments).add:
        read_recordings(added)
        if (FOLDER / added.name).exists():
            parser.error(f"{FOLDER / added.name}: is there already; rename {added}")
        shutil.copyfile(added, FOLDER / added.name)
    classifier = Classifier.load()
    emitted = {path: outline(answers(stream_of(path), classifier)) for path in RECORDINGS}
    emitted |= {path: output_of(path, classifier) for path in paths()}
    for path, events in emitted.items():
        expectation_of(path).write_text("".join(f"{json.dumps(event)}\n" for event in events))


if __name__ == "__main__":
    main(sys.argv[1:])
