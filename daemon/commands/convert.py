"""`touchd convert`: a journal or a recording as CSV or MCAP."""

import argparse
import csv
import io
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import msgspec

from daemon.events import Event, EventError
from daemon.kept.journal import JournalError
from daemon.kept.touches import lines_in
from drivers.errors import TouchdError, os_errors_as
from drivers.recording import SUFFIXES, read_provenance, read_recordings, write_recordings
from drivers.whole_file import whole_file


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
    if out.suffix == ".mcap":
        # Before the work, as it may not be installed.
        import daemon.convert.mcap  # noqa: F401
    try:
        with whole_file(out, replace=False) as partial:
            if file.name.endswith(SUFFIXES):
                _convert_recording(file, partial)
            else:
                _convert_journal(file, partial)
    except OSError as error:
        raise ConvertError(f"{out}: {error.strerror}; give another --out") from error
    sys.stdout.write(f"{out}\n")
    return 0


def _convert_recording(file: Path, out: Path) -> None:
    recordings = read_recordings(file)
    if out.suffix == ".csv":
        write_recordings(out, recordings, read_provenance(file))
        return
    from daemon.convert import mcap

    with out.open("xb") as target:
        mcap.write_recordings(recordings, target)


def _convert_journal(file: Path, out: Path) -> None:
    # Read once: a running daemon may write on, and begin another file.
    with os_errors_as(JournalError, f"journal {file}: cannot be read", "check the path"):
        journal = io.BytesIO(file.read_bytes())
    if not any(True for _ in _read(file, journal)):
        raise ConvertError(f"{file}: no events in it")
    journal.seek(0)
    if wrong := sum(isinstance(line, EventError) for line in lines_in(journal)):
        sys.stderr.write(f"{file}: left out {wrong} lines that are no events\n")
    if out.suffix == ".csv":
        columns = dict.fromkeys(name for event in _read(file, journal) for name in _flat(event))
        with out.open("x", encoding="utf-8", newline="") as target:
            # For pandas and spreadsheets.
            table = csv.DictWriter(target, list(columns), lineterminator="\n")
            table.writeheader()
            table.writerows(map(_flat, _read(file, journal)))
        return
    from daemon.convert import mcap

    with out.open("xb") as messages:
        mcap.write_events(_read(file, journal), messages)


def _read(path: Path, journal: io.BytesIO) -> Iterator[Event]:
    """Yield a journal's events from its beginning; raises JournalError when it does not begin with one."""
    journal.seek(0)
    for number, event in enumerate(lines_in(journal), 1):
        if not isinstance(event, EventError):
            yield event
        elif number == 1:
            raise JournalError(f"{path}, line {number}: {event}")


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
