"""Turns recordings into a pad's stream (selects, realigns, adds notouch around touches), and plays it."""

import argparse
import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from itertools import groupby
from pathlib import Path

import numpy as np
from rich.console import Console

from touchd.daemon.path.pipeline import Clock, Pipeline
from touchd.drivers.frame import FRAME_RATE_HZ, NO_TOUCH, Frame
from touchd.drivers.recording import (
    KEYS,
    SUFFIXES,
    Recording,
    RecordingError,
    Stream,
    ideal_clock_ms,
    read_recordings,
    realign,
    recordings_in,
    setup_of,
    splice,
)

DEMO_RECORDING = Path(__file__).parent / "data" / "demo.csv.gz"
# Long enough for a touch to end and the baseline to settle, short enough to wait for.
QUIET_FRAMES = round(4.0 * FRAME_RATE_HZ)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the recording files and the options that select among their recordings."""
    parser.add_argument(
        "files",
        nargs="*",
        type=Path,
        default=[DEMO_RECORDING],
        metavar="FILE",
        help="recordings, .csv or .csv.gz, or folders of them; the demo's without it",
    )
    for key, example in zip(KEYS, ("P3", "foam", "fur", "stroke"), strict=True):
        parser.add_argument(
            f"--{key}",
            action="append",
            default=[],
            metavar=example,
            help=f"only recordings of this {key}; may be given several times",
        )


def chosen_stream(arguments: argparse.Namespace) -> Stream:
    """Return the recordings selected by the arguments as one stream; raises RecordingError."""
    select = {key: getattr(arguments, key) for key in KEYS}
    files, gestures = recording_files(arguments.files), select["gesture"]
    if gestures:
        select["gesture"] = [*gestures, NO_TOUCH]
    found: list[Recording] = []
    # A large file takes seconds.
    with Console(stderr=True).status("") as status:
        for path in files:
            status.update(f"reading {path}")
            found += [realign(recording) for recording in read_recordings(path, select)]
    wanted = [recording for recording in found if not gestures or recording.gesture in gestures]
    if not wanted:
        why = f"no recording matches; {_there_are(files)}" if any(select.values()) else "no frames"
        raise RecordingError(f"{', '.join(map(str, arguments.files))}: {why}")
    return with_quiet(wanted, [recording for recording in found if recording.gesture == NO_TOUCH])


def recording_files(paths: Sequence[Path]) -> list[Path]:
    """Return the files among paths, and for each folder its recordings in order of their names."""
    files: list[Path] = []
    for path in paths:
        inside = recordings_in(path) if path.is_dir() else [path]
        if not inside:
            raise RecordingError(f"{path}: no recording ({' or '.join(SUFFIXES)}) is in this folder")
        files += inside
    return files


def _there_are(files: Sequence[Path]) -> str:
    """List the participants, substrates, covers and gestures of recordings, in words."""
    found = [recording for path in files for recording in read_recordings(path)]
    names = {key: sorted({getattr(recording, key) for recording in found}) for key in KEYS}
    return "; ".join(f"{key} is one of {', '.join(some)}" for key, some in names.items())


def play(
    stream: Stream, make: Callable[[Clock], Pipeline], at: Callable[[int], None] = lambda number: None
) -> None:
    """Send a whole stream through a pipeline at full speed. at: called with each frame's number first.

    make: returns the pipeline, given the recording's clock. With the computer's clock, answers would be too
    old on a computer that is slower than the recording.
    """
    frame_s = since_s = 0.0

    def now_s() -> float:
        return frame_s + time.monotonic() - since_s

    pipeline = make(Clock(now_s))
    for number, (sensor_ms, counts) in enumerate(zip(stream.sensor_ms.tolist(), stream.counts, strict=True)):
        at(number)
        frame_s, since_s = sensor_ms / 1000, time.monotonic()
        pipeline.on_frame(Frame(sensor_ms, frame_s, counts))
    pipeline.flush()


def with_quiet(recordings: Sequence[Recording], quiet: Sequence[Recording]) -> Stream:
    """Splice recordings with four seconds of notouch before, between and after those that touch.

    Each participant and condition gets its own quiet before and after.
    quiet: notouch recordings to use, preferably of the same participant and condition, else of the same
    participant, else any. Without any, the lowest count of each taxel is used.
    """
    parts: list[tuple[Recording, bool]] = []
    for _, together in groupby(recordings, key=setup_of):
        is_quiet = False
        for recording in together:
            if recording.gesture != NO_TOUCH and not is_quiet:
                parts.append((_quiet_for(recording, quiet), True))
            parts.append((recording, False))
            is_quiet = recording.gesture == NO_TOUCH
        if not is_quiet:
            parts.append((_quiet_for(recording, quiet), True))
    played, are_added = zip(*parts, strict=True)
    stream = splice(played)
    spans = zip(stream.spans, are_added, strict=True)
    return replace(stream, spans=tuple(replace(span, is_added=is_added) for span, is_added in spans))


def _quiet_for(recording: Recording, quiet: Sequence[Recording]) -> Recording:
    if not quiet:
        rest = np.repeat(recording.counts.min(axis=0, keepdims=True), QUIET_FRAMES, axis=0)
        return replace(recording, gesture=NO_TOUCH, counts=rest, sensor_ms=ideal_clock_ms(QUIET_FRAMES))
    person, setup = recording.participant, setup_of(recording)
    best = max(quiet, key=lambda one: (one.participant == person, setup_of(one) == setup))
    # Keep participant and condition: otherwise the clock would restart, and rest be measured under a hand.
    quiet_ms = 1000 * QUIET_FRAMES / FRAME_RATE_HZ
    frames = int(np.searchsorted(best.sensor_ms, best.sensor_ms[0] + quiet_ms))
    counts, sensor_ms = best.counts[:frames], best.sensor_ms[:frames]
    return replace(recording, gesture=NO_TOUCH, counts=counts, sensor_ms=sensor_ms)
