"""`touchd convert`: a journal as CSV or MCAP, a recording as MCAP."""

import argparse
import csv
import io
import sys
from collections.abc import Sequence
from itertools import chain
from pathlib import Path
from typing import IO, Any

import msgspec
from rich.console import Console

from touchd.daemon.path.events import Event
from touchd.daemon.sinks.journal import JournalError, journal_files
from touchd.daemon.sinks.touches import read_events
from touchd.drivers.errors import TouchdError, os_errors_as
from touchd.drivers.recording import SUFFIXES, read_recordings
from touchd.drivers.whole_file import PRIVATE_MODE, whole_file

DESCRIPTION = "Writes a journal as CSV (for pandas), a journal or a recording as MCAP (for Foxglove)."


class ConvertError(TouchdError):
    """A file cannot be converted; the message says why."""


def add_options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("file", type=Path, metavar="FILE", help="a journal, or a recording (.csv, .csv.gz)")
    parser.add_argument("-o", "--out", type=Path, required=True, help="a new .csv or .mcap file")


def main(options: argparse.Namespace) -> int:
    """Write the file and print its name; returns 0."""
    file, out = options.file, options.out
    is_recording = file.name.endswith(SUFFIXES)
    if out.suffix not in (".csv", ".mcap"):
        raise ConvertError(f"{out}: unknown format; end the name of --out with .csv or .mcap")
    if is_recording and out.suffix == ".csv":
        raise ConvertError(f"{file}: a recording is CSV already; end the name of --out with .mcap")
    if out.exists():
        raise ConvertError(f"{out}: exists; give another --out, or move the file away")
    if out.suffix == ".mcap":
        # It may not be installed.
        from touchd.daemon.record import mcap
    with (
        Console(stderr=True).status(f"reading {file}"),
        os_errors_as(ConvertError, f"{out}: cannot be written", "give another --out"),
        whole_file(out, replace=False, mode=PRIVATE_MODE) as partial,
        partial.open("xb") as target,
    ):
        if is_recording:
            mcap.write_recordings(read_recordings(file), target)
        elif out.suffix == ".mcap":
            mcap.write_events(_events_in(file), target)
        else:
            _write_table(_events_in(file), target)
    sys.stdout.write(f"{out}\n")
    return 0


def _events_in(file: Path) -> Sequence[Event]:
    """Return the events of a journal and its older files, oldest first; raises JournalError without any."""
    events, wrong = read_events(file)
    # The older files are beside a symlink's target.
    for older in filter(Path.exists, journal_files(file.resolve())[1:]):
        found, errors = read_events(older)
        events, wrong = found + events, errors + wrong
    if not events:
        raise JournalError(f"{file}, line 1: {wrong[0]}" if wrong else f"{file}: no events in it")
    if wrong:
        sys.stderr.write(f"{file}: skipped {len(wrong)} lines that are not events\n")
    return events


def _write_table(events: Sequence[Event], target: IO[bytes]) -> None:
    """Write events as CSV that pandas and spreadsheets read."""
    columns = list(dict.fromkeys(chain.from_iterable(map(_flat, events))))
    with io.TextIOWrapper(target, encoding="utf-8", newline="") as text:
        table = csv.DictWriter(text, columns, lineterminator="\n")
        table.writeheader()
        # Build the rows twice instead of storing them: those of a journal of years would take gigabytes.
        table.writerows(map(_flat, events))


def _flat(event: Event) -> dict[str, Any]:
    """Flatten an event; a field of a mapping gets both names, as in probabilities_pat."""
    row: dict[str, Any] = {}
    for name, value in msgspec.to_builtins(event).items():
        if isinstance(value, dict):
            row |= {f"{name}_{key}": part for key, part in value.items()}
        else:
            row[name] = value
    return row
