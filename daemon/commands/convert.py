"""`touchd convert`: a journal or a recording as CSV or MCAP."""

import argparse
import csv
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import IO, Any

import msgspec

from daemon.events import Event, EventError
from daemon.kept.journal import JournalError
from daemon.kept.touches import read_lines
from drivers.errors import TouchdError
from drivers.recording import SUFFIXES, read_provenance, read_recordings, write_recordings


class ConvertError(TouchdError):
    """The file cannot be converted; the message is one line that says why."""


def parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="touchd convert",
        description="Writes a journal or a recording as CSV (for pandas) or as MCAP (for Foxglove).",
    )
    parser.add_argument("file", type=Path, metavar="FILE", help="a journal, or a recording (.csv, .csv.gz)")
    parser.add_argument(
        "-o", "--out", type=Path, required=True, metavar="OUT", help="a new .csv or .mcap file"
    )
    return parser


def main(arguments: Sequence[str]) -> int:
    """Write the file and name it; returns 0."""
    options = parser().parse_args(arguments)
    file, out = options.file, options.out
    if out.suffix not in (".csv", ".mcap"):
        raise ConvertError(f"{out}: neither .csv nor .mcap; give --out a name that ends so")
    if out.exists():
        raise ConvertError(f"{out}: is there already; give another --out, or move it away")
    is_recording = file.name.endswith(SUFFIXES)
    if out.suffix == ".mcap":
        # Before the work, as it may not be installed.
        from daemon.convert import mcap
    try:
        if is_recording:
            recordings = read_recordings(file)
            if out.suffix == ".csv":
                write_recordings(out, recordings, read_provenance(file))
            else:
                with out.open("xb") as target:
                    mcap.write_recordings(recordings, target)
        else:
            # The journal's faults are reported before there is a file.
            if not sum(1 for _ in read(file)):
                raise ConvertError(f"{file}: no events in it")
            if out.suffix == ".csv":
                with out.open("x", encoding="utf-8", newline="") as table:
                    _write_table(file, table)
            else:
                with out.open("xb") as target:
                    mcap.write_events(read(file), target)
    except OSError as error:
        raise ConvertError(f"{error.filename}: {error.strerror}; give another --out") from error
    sys.stdout.write(f"{out}\n")
    return 0


def read(path: Path) -> Iterator[Event]:
    """Yield a journal's events. Raises JournalError."""
    for number, event in enumerate(read_lines(path), 1):
        if isinstance(event, EventError):
            raise JournalError(f"{path}, line {number}: {event}")
        yield event


def _write_table(journal: Path, file: IO[str]) -> None:
    """Write a row an event, a column each field, for pandas and spreadsheets."""
    columns = dict.fromkeys(name for event in read(journal) for name in _flat(event))
    table = csv.DictWriter(file, list(columns), lineterminator="\n")
    table.writeheader()
    table.writerows(map(_flat, read(journal)))


def _flat(event: Event) -> dict[str, Any]:
    """Return an event's fields by name; those of a mapping are called by both names: probabilities_pat."""
    row: dict[str, Any] = {}
    for name, value in msgspec.to_builtins(event).items():
        row |= (
            {f"{name}_{key}": part for key, part in value.items()}
            if isinstance(value, dict)
            else {name: value}
        )
    return row
