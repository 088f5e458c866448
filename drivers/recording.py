"""Recordings of the pad in files: HAART's two CSV layouts and our own, read, written, realigned, spliced.

HAART's layouts (RTGC 2015): `ParticipantNo,Substrate,Cover,Gesture` and 64 cells, or
`ParticipantID,Substrate,Cover,Gesture,Sequence` and 64 cells, with or without quotes and spaces in the header.
Ours: `# key: value` lines of provenance, then `participant,substrate,cover,gesture,sensor_ms` and 64 cells.
Consecutive rows that share participant, substrate, cover and gesture are one recording.
"""

from __future__ import annotations

import csv
import gzip
import io
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import IO, Literal

import numpy as np
from numpy.typing import NDArray

from drivers.frame import COLUMNS, FRAME_RATE_HZ, MAX_COUNT, ROWS, Counts

CELLS = ROWS * COLUMNS
KEYS = ("participant", "substrate", "cover", "gesture")
SEAM_ROWS = 2
Framing = Literal["published", "live"]


class RecordingError(Exception):
    """A recording file cannot be read; the message names file, line and what is wrong."""


@dataclass(frozen=True, eq=False)
class Recording:
    """One gesture by one participant under one condition.

    counts: (T, 8, 8) uint16, 0 (no pressure) to 1023. sensor_ms: (T,) int64, ideal 54 Hz where the file has no clock.
    framing: "live" holds whole scans; "published" is HAART's, rolled by two rows across scans (see `realign`).
    """

    participant: str
    substrate: str
    cover: str
    gesture: str
    counts: Counts
    sensor_ms: NDArray[np.int64]
    framing: Framing


@dataclass(frozen=True)
class Selection:
    """Which recordings of a file are wanted; an empty tuple means any."""

    participants: tuple[str, ...] = ()
    substrates: tuple[str, ...] = ()
    covers: tuple[str, ...] = ()
    gestures: tuple[str, ...] = ()

    def wants(self, keys: Sequence[str]) -> bool:
        """Whether a recording with these four keys (participant, substrate, cover, gesture) is selected."""
        wanted = (self.participants, self.substrates, self.covers, self.gestures)
        return all(not some or key in some for some, key in zip(wanted, keys, strict=True))


EVERYTHING = Selection()


@dataclass(frozen=True)
class Span:
    """A labelled stretch of a stream: frames start <= i < stop show `gesture`."""

    start: int
    stop: int
    gesture: str


@dataclass(frozen=True, eq=False)
class Stream:
    """What a pad would send: counts (T, 8, 8) uint16, sensor_ms (T,) int64, and what is true when."""

    counts: Counts
    sensor_ms: NDArray[np.int64]
    spans: tuple[Span, ...]


def ideal_clock_ms(frames: int, first_ms: int = 0) -> NDArray[np.int64]:
    """Return the sensor clock of `frames` frames at exactly 54 Hz, rounded to whole milliseconds."""
    return first_ms + np.rint(np.arange(frames) * 1000.0 / FRAME_RATE_HZ).astype(np.int64)


def read_recordings(path: Path, select: Selection = EVERYTHING) -> list[Recording]:
    """Read the selected recordings of a .csv or .csv.gz file, in file order.

    Raises RecordingError when the file is missing, no known layout, or holds a value that no pad can send.
    """
    try:
        with _open_text(path, "r") as file:
            return list(_parse(path, file, select))
    except (OSError, EOFError, UnicodeDecodeError, csv.Error) as error:
        raise RecordingError(f"{path}: cannot be read as a recording ({error})") from error


def write_recordings(path: Path, recordings: Sequence[Recording], provenance: Mapping[str, str]) -> None:
    """Write recordings in our own layout (.csv or .csv.gz), provenance first; never overwrites."""
    with _open_text(path, "x") as file:
        for key, value in provenance.items():
            file.write(f"# {key}: {value}\n")
        names = [*KEYS, "sensor_ms", *(f"cell{i}" for i in range(1, CELLS + 1))]
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(names)
        for recording in recordings:
            keys = [recording.participant, recording.substrate, recording.cover, recording.gesture]
            for ms, frame in zip(recording.sensor_ms, recording.counts, strict=True):
                writer.writerow([*keys, int(ms), *frame.ravel().tolist()])


def realign(recording: Recording) -> Recording:
    """Return a published recording as the sensor's own scans: (T - 1, 8, 8), framing "live".

    HAART was cut 54 rows of 8 into the row stream, so that each published frame holds the last two rows of one
    scan before the first six of the next; dropping the first 2 and the last 6 rows regroups whole scans.
    A live recording is returned as it is.
    """
    if recording.framing == "live":
        return recording
    rows = recording.counts.reshape(-1, COLUMNS)
    counts = rows[SEAM_ROWS : SEAM_ROWS - ROWS].reshape(-1, ROWS, COLUMNS)
    return replace(recording, counts=counts, sensor_ms=recording.sensor_ms[: len(counts)], framing="live")


def splice(recordings: Sequence[Recording]) -> Stream:
    """Join recordings end to end into one stream whose clock runs on without a jump."""
    spans: list[Span] = []
    clocks: list[NDArray[np.int64]] = []
    start = 0
    next_ms = 0
    period_ms = round(1000.0 / FRAME_RATE_HZ)
    for recording in recordings:
        stop = start + len(recording.counts)
        spans.append(Span(start, stop, recording.gesture))
        clocks.append(recording.sensor_ms - recording.sensor_ms[0] + next_ms)
        next_ms = int(clocks[-1][-1]) + period_ms
        start = stop
    return Stream(
        counts=np.concatenate([recording.counts for recording in recordings]),
        sensor_ms=np.concatenate(clocks),
        spans=tuple(spans),
    )


def _open_text(path: Path, mode: Literal["r", "x"]) -> IO[str]:
    if path.suffix == ".gz":
        return io.TextIOWrapper(gzip.open(path, f"{mode}b"), encoding="utf-8", newline="")  # type: ignore[arg-type]
    return path.open(mode, encoding="utf-8", newline="")


def _parse(path: Path, file: IO[str], select: Selection) -> Iterator[Recording]:
    line_number = 1
    line = file.readline()
    while line.startswith("#"):
        line = file.readline()
        line_number += 1
    header = [name.strip().strip('"').lower() for name in line.split(",")]
    extra = _extra_column(path, header)
    width = len(header)
    first_cell = width - CELLS
    keys: tuple[str, ...] = ()
    rows: list[list[str]] = []
    for line_number, row in enumerate(csv.reader(file, skipinitialspace=True), line_number + 1):
        if len(row) != width:
            raise RecordingError(
                f"{path}, line {line_number}: {len(row)} columns where the header has {width}"
            )
        row_keys = tuple(row[: len(KEYS)])
        if row_keys != keys:
            if rows:
                yield _recording(path, line_number, keys, rows, extra, first_cell)
            keys, rows = row_keys, []
        if select.wants(row_keys):
            rows.append(row)
    if rows:
        yield _recording(path, line_number, keys, rows, extra, first_cell)


def _extra_column(path: Path, header: Sequence[str]) -> Literal["", "sequence", "sensor_ms"]:
    """Return the name of the column between the keys and the cells; the official test file has one more."""
    if [name[:11] for name in header[1:4]] == ["substrate", "cover", "gesture"] and header[-CELLS] == "cell1":
        between = tuple(header[4:-CELLS])
        if between == ():
            return ""
        if between == ("sequence",):
            return "sequence"
        if between == ("sensor_ms",):
            return "sensor_ms"
    raise RecordingError(
        f"{path}: no known layout (expected participant, substrate, cover, gesture and {CELLS} cells)"
    )


def _recording(
    path: Path, line_number: int, keys: tuple[str, ...], rows: list[list[str]], extra: str, first_cell: int
) -> Recording:
    try:
        numbers = np.array(rows, dtype=object)[:, len(KEYS) :].astype(np.int64)
    except ValueError as error:
        raise RecordingError(f"{path}, before line {line_number}: not a whole number ({error})") from error
    cells = numbers[:, first_cell - len(KEYS) :]
    if cells.min() < 0 or cells.max() > MAX_COUNT:
        raise RecordingError(f"{path}, before line {line_number}: a count outside 0 to {MAX_COUNT}")
    counts = cells.astype(np.uint16).reshape(-1, ROWS, COLUMNS)
    live = extra == "sensor_ms"
    sensor_ms = numbers[:, 0] if live else ideal_clock_ms(len(counts))
    return Recording(keys[0], keys[1], keys[2], keys[3], counts, sensor_ms, "live" if live else "published")
