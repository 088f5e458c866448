"""Reads, writes, realigns and splices recordings of the pad: HAART's two CSV layouts and touchd's own.

HAART's layouts (RTGC 2015): `ParticipantNo,Substrate,Cover,Gesture` and 64 cells, or
`ParticipantID,Substrate,Cover,Gesture,Sequence` and 64 cells, with or without quotes and spaces.
Ours: `# key: value` lines of provenance, then `participant,substrate,cover,gesture,sensor_ms` and 64 cells.
Consecutive rows that share participant, substrate, cover and gesture are one recording.
"""

import csv
import gzip
import io
import tempfile
import zlib
from array import array
from collections.abc import Collection, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import partial
from itertools import groupby, pairwise
from pathlib import Path
from types import MappingProxyType
from typing import IO, Literal, NamedTuple, cast

import numpy as np
from numpy.typing import NDArray

from touchd.drivers.errors import TouchdError, os_errors_as, reason
from touchd.drivers.frame import CLOCK_MODULUS, COLUMNS, FRAME_RATE_HZ, MAX_COUNT, ROWS, Counts, Frame
from touchd.drivers.pad.grid import Ring
from touchd.drivers.whole_file import PRIVATE_MODE, open_nonblocking, whole_file

CELLS = ROWS * COLUMNS
SUFFIXES = (".csv", ".csv.gz")
# Suffix of the recordings that touchd makes.
SUFFIX = ".csv.gz"
KEYS = ("participant", "substrate", "cover", "gesture")
SEAM_ROWS = 2
PERIOD_MS = round(1000.0 / FRAME_RATE_HZ)
# With fewer steps, a clock is not checked; a clock with longer steps does not count milliseconds.
LEAST_STEPS, SLOWEST_STEP_MS = 4, 1000
UNLABELLED = "unlabelled"
"""Placeholder for the label, and for who touched what, of a recording that nobody has labelled yet."""
# Five hours at 54 Hz, and many times the longest line of any layout: a file beyond that is not a recording.
MOST_LINES = 1_000_000
LONGEST_LINE = 4096
Framing = Literal["published", "live"]
Keys = tuple[str, str, str, str]
Selection = Mapping[str, Collection[str]]
EVERYTHING: Selection = MappingProxyType({})


class RecordingError(TouchdError):
    """A recording file cannot be read; the message names file, line and what is wrong."""


@dataclass(frozen=True, eq=False)
class Recording:
    """One gesture by one participant under one condition.

    counts: (T, 8, 8), 0 (no pressure) to 1023; uint16 as sent, float32 once laid on the 54 Hz grid.
    sensor_ms: (T,) int64, ideal 54 Hz where the file has no clock. framing: "live" holds whole scans;
    "published" is HAART's, rolled by two rows (see `realign`).
    """

    participant: str
    substrate: str
    cover: str
    gesture: str
    counts: Counts | NDArray[np.float32]
    sensor_ms: NDArray[np.int64]
    framing: Framing


@dataclass(frozen=True)
class Span:
    """A labelled stretch of a stream: frames start <= i < stop show `gesture`.

    is_added: whether it was added between recordings, to play them.
    """

    start: int
    stop: int
    gesture: str
    is_added: bool = False


@dataclass(frozen=True, eq=False)
class Stream:
    """What a pad would send: counts (T, 8, 8) uint16, sensor_ms (T,) int64, and the gesture in each span."""

    counts: Counts
    sensor_ms: NDArray[np.int64]
    spans: tuple[Span, ...]


def ideal_clock_ms(frames: int, first_ms: int = 0) -> NDArray[np.int64]:
    """Return the sensor clock of `frames` frames at exactly 54 Hz, rounded to whole milliseconds."""
    clock_ms: NDArray[np.int64] = np.rint(np.arange(frames) * 1000.0 / FRAME_RATE_HZ).astype(np.int64)
    return clock_ms + first_ms


def recordings_in(folder: Path) -> list[Path]:
    """Return a folder's recordings by name, without those that are being written. Raises OSError."""
    found = sorted(path for path in folder.iterdir() if path.name.endswith(SUFFIXES))
    return [path for path in found if not path.name.startswith(".")]


def read_recordings(path: Path, select: Selection = EVERYTHING) -> list[Recording]:
    """Read the selected recordings of a .csv or .csv.gz file, in file order.

    select: accepted values by the names in KEYS; a key without values accepts any.
    Raises RecordingError if the file is missing, has no known layout, or holds a value that no pad can send.
    """
    with _lines_of(path) as lines:
        return list(_parse(path, lines, select))


def write_recordings(path: Path, recordings: Sequence[Recording], provenance: Mapping[str, str]) -> None:
    """Write recordings to a new file (.csv or .csv.gz) in our own layout, whole or not at all.

    Raises RecordingError when the file exists or cannot be written, or when two recordings in a row share all
    four keys, as they would be read back as one.
    """
    if any(_keys(earlier) == _keys(later) for earlier, later in pairwise(recordings)):
        raise RecordingError(f"{path}: two in a row share participant, condition and gesture")
    try:
        opened = gzip.open if path.suffix == ".gz" else open
        with (
            whole_file(path, replace=False, mode=PRIVATE_MODE) as partial,
            opened(partial, "xt", encoding="utf-8", newline="") as file,
        ):
            for key, value in provenance.items():
                file.write(f"# {key}: {' '.join(value.split())}\n")
            writer = csv.writer(file, lineterminator="\n")
            writer.writerow([*KEYS, "sensor_ms", *(f"cell{i}" for i in range(1, CELLS + 1))])
            for recording in recordings:
                for ms, frame in zip(recording.sensor_ms, recording.counts, strict=True):
                    writer.writerow([*_keys(recording), int(ms), *frame.ravel().tolist()])
    except FileExistsError as error:
        raise RecordingError(f"{path}: is there already, and is never written over") from error
    except OSError as error:
        raise RecordingError(f"{path}: cannot be written ({error.strerror})") from error


def prepare_folder(folder: Path) -> None:
    """Make a folder for recordings, and check that files can be made in it; raises RecordingError."""
    with os_errors_as(RecordingError, f"{folder}: recordings cannot be kept there", "name another folder"):
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            pass


def realign(recording: Recording) -> Recording:
    """Return a published recording as the sensor's own scans: (T - 1, 8, 8), framing "live".

    HAART was cut 54 rows of 8 into the row stream, so that each published frame holds the last two rows of
    one scan before the first six of the next; dropping the first 2 and the last 6 rows regroups whole scans.
    A live recording is returned as it is. Raises RecordingError for a single published frame.
    """
    if recording.framing == "live":
        return recording
    if len(recording.counts) < 2:
        what = f"{recording.participant}, {recording.gesture}"
        raise RecordingError(f"{what}: one row is no whole scan; the rows of a recording stand together")
    rows = recording.counts.reshape(-1, COLUMNS)
    counts = rows[SEAM_ROWS : SEAM_ROWS - ROWS].reshape(-1, ROWS, COLUMNS)
    return replace(recording, counts=counts, sensor_ms=recording.sensor_ms[: len(counts)], framing="live")


def on_grid(recording: Recording) -> Recording:
    """Return a recording's longest stretch without a gap, on the 54 Hz grid as in the daemon.

    Counts become float32, because interpolated frames lie between whole counts.
    """
    ring = Ring(capacity=1)
    stretches: list[list[NDArray[np.float32]]] = []
    for scan, ms in zip(recording.counts, recording.sensor_ms.tolist(), strict=True):
        for laid in ring.push(Frame(ms % CLOCK_MODULUS, 0.0, scan.astype(np.uint16))):
            if laid.restarted:
                stretches.append([])
            stretches[-1].append(laid.pressure)
    counts = np.stack(max(stretches, key=len))
    return replace(recording, counts=counts, sensor_ms=ideal_clock_ms(len(counts)))


def setup_of(recording: Recording) -> tuple[str, str, str]:
    """Return who touched what: participant, substrate, cover."""
    return recording.participant, recording.substrate, recording.cover


def splice(recordings: Sequence[Recording]) -> Stream:
    """Join recordings end to end into one stream, as one pad would send it.

    The clock runs on without a jump. Where participant, substrate or cover change, it restarts, as after the
    pad was set up again, because its rest differs. Raises RecordingError when there are no recordings.
    """
    if not recordings:
        raise RecordingError("no recording to play: none matches what was selected")
    spans: list[Span] = []
    clocks: list[NDArray[np.int64]] = []
    start, next_ms = 0, 0
    for before, recording in zip([recordings[0], *recordings], recordings, strict=False):
        if setup_of(recording) != setup_of(before):
            next_ms = 0
        spans.append(Span(start, start + len(recording.counts), recording.gesture))
        clocks.append(recording.sensor_ms - recording.sensor_ms[0] + next_ms)
        start, next_ms = spans[-1].stop, int(clocks[-1][-1]) + PERIOD_MS
    counts = np.concatenate([recording.counts for recording in recordings])
    return Stream(counts, np.concatenate(clocks), tuple(spans))


class _Header(NamedTuple):
    """A header: its line number, the number of columns, whether one is a clock, and the separator."""

    line_number: int
    width: int
    has_clock: bool
    separator: str


def _keys(recording: Recording) -> Keys:
    return (*setup_of(recording), recording.gesture)


@contextmanager
def _lines_of(path: Path) -> Iterator[Iterator[str]]:
    """Yield the lines of a file; raises RecordingError if it turns out to be damaged."""
    try:
        with open(path, "rb", opener=open_nonblocking) as file:
            unpacked = cast(io.BufferedReader, gzip.GzipFile(fileobj=file) if path.suffix == ".gz" else file)
            # utf-8-sig: spreadsheets begin a file with a byte order mark.
            yield _lines(path, io.TextIOWrapper(unpacked, encoding="utf-8-sig", newline=""))
    except (OSError, EOFError, UnicodeDecodeError, zlib.error, csv.Error) as error:
        encoding = "no UTF-8 text; is it compressed, or saved in another encoding?"
        why = encoding if isinstance(error, UnicodeDecodeError) else reason(error)
        raise RecordingError(f"{path}: cannot be read as a recording ({why})") from error


def _lines(path: Path, file: IO[str]) -> Iterator[str]:
    for number, line in enumerate(iter(partial(file.readline, LONGEST_LINE), ""), 1):
        if number > MOST_LINES:
            raise RecordingError(f"{path}: more than {MOST_LINES} lines, split it into shorter recordings")
        if len(line) == LONGEST_LINE:
            raise RecordingError(f"{path}, line {number}: too long for a recording")
        yield line


def _parse(path: Path, lines: Iterator[str], select: Selection) -> Iterator[Recording]:
    header = _read_header(path, lines)
    for keys, rows in groupby(_rows(path, lines, header), lambda numbered: _keys_of(numbered[1])):
        if any(key not in (select.get(name) or (key,)) for name, key in zip(KEYS, keys, strict=True)):
            continue
        stamps, cells = array("q"), array("H")
        for line_number, row in rows:
            try:
                if header.has_clock:
                    stamps.append(int(row[len(KEYS)]))
                frame = list(map(int, row[-CELLS:]))
                if min(frame) < 0 or max(frame) > MAX_COUNT:
                    raise ValueError(f"a count outside 0 to {MAX_COUNT}")
                cells.fromlist(frame)
            except (ValueError, OverflowError) as error:
                what = str(error).replace(" for int() with base 10", ", no whole number")
                raise RecordingError(f"{path}, line {line_number}: {what}") from error
        counts = np.array(cells, dtype=np.uint16).reshape(-1, ROWS, COLUMNS)
        if header.has_clock:
            clock_ms = np.array(stamps, dtype=np.int64)
            _check_clock(f"{path}: {', '.join(keys)}", clock_ms)
            yield Recording(*keys, counts, clock_ms, "live")
        else:
            yield Recording(*keys, counts, ideal_clock_ms(len(counts)), "published")


def _check_clock(what: str, clock_ms: NDArray[np.int64]) -> None:
    """Refuse a clock that stands still, runs back or does not count milliseconds."""
    steps = np.diff(clock_ms)
    if len(steps) >= LEAST_STEPS and not 0 < (usual_ms := float(np.median(steps))) <= SLOWEST_STEP_MS:
        must = "it must rise by milliseconds, not microseconds, and may not stand still or fall"
        raise RecordingError(f"{what}: sensor_ms changes by {usual_ms:g} a frame; {must}")


def _rows(path: Path, lines: Iterator[str], header: _Header) -> Iterator[tuple[int, list[str]]]:
    """Yield the rows after the header that are not empty, with the numbers of their lines."""
    reader = csv.reader(lines, delimiter=header.separator, skipinitialspace=True)
    for number, row in enumerate(reader, header.line_number + 1):
        if len(row) not in (0, header.width):
            columns = f"{len(row)} columns where the header has {header.width}"
            raise RecordingError(f"{path}, line {number}: {columns}")
        if row:
            yield number, row


def _keys_of(row: Sequence[str]) -> Keys:
    participant, substrate, cover, gesture = map(str.strip, row[: len(KEYS)])
    return participant, substrate, cover, gesture


def _read_header(path: Path, lines: Iterator[str]) -> _Header:
    """Read up to the header; HAART's test file has one column more than its training file."""
    for number, line in enumerate(lines, 1):
        # Spreadsheets quote a comment that contains a comma.
        if line.lstrip('"').startswith("#"):
            continue
        # Spreadsheets write semicolons in languages with a decimal comma.
        separator = next((mark for mark in ",;\t" if mark in line), ",")
        header = [name.strip().strip('"').strip().lower() for name in line.split(separator)]
        between = header[4:-CELLS]
        is_known = header[1:4] == ["substrate", "cover", "gesture"] and header[-CELLS:][0] == "cell1"
        if is_known and between in ([], ["sequence"], ["sensor_ms"]):
            return _Header(number, len(header), "sensor_ms" in between, separator)
        expected = f"expected participant, substrate, cover, gesture, {CELLS} cells, no more"
        raise RecordingError(f"{path}: no known layout ({expected})")
    raise RecordingError(f"{path}: holds no rows")
