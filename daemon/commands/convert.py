"""`touchd convert`: a journal as CSV or MCAP, a recording as MCAP."""

import argparse
import csv
import sys
from itertools import chain
from pathlib import Path
from typing import Any

import msgspec
from rich.console import Console

from touchd.daemon.path.events import Event
from touchd.daemon.sinks.journal import JournalError
from touchd.daemon.sinks.touches import read_events
from touchd.drivers.errors import TouchdError, os_errors_as
from touchd.drivers.recording import SUFFIXES, read_recordings
from touchd.drivers.whole_file import PRIVATE_MODE, whole_file

DESCRIPTION = "Writes a journal as CSV (for pandas), a journal or a recording as MCAP (for Foxglove)."


class ConvertError(TouchdError):
    """A file cannot be converted; the message says why."""


def add_options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("file", type=Path, metavar="FILE", help="a journal, or a recording (.csv, .csv.gz)")
    parser.add_argument(
        "-o", "--out", type=Path, required=True, metavar="OUT", help="a new .csv or .mcap file"
    )


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
        # Fail before the work if mcap is not installed.
        import touchd.daemon.record.mcap  # noqa: F401
    with (
        Console(stderr=True).status(f"reading {file}"),
        os_errors_as(ConvertError, f"{out}: cannot be written", "give another --out"),
        whole_file(out, replace=False, mode=PRIVATE_MODE) as partial,
    ):
        if is_recording:
            _write_recording(file, partial)
        else:
            _write_journal(file, partial, is_csv=out.suffix == ".csv")
    sys.stdout.write(f"{out}\n")
    return 0


def _write_recording(file: Path, out: Path) -> None:
    from touchd.daemon.record import mcap

    with out.open("xb") as target:
        mcap.write_recordings(read_recordings(file), target)


def _write_journal(file: Path, out: Path, *, is_csv: bool) -> None:
    # Read once: a running daemon may append to the file or rotate it.
    events, wrong = read_events(file)
    if not events:
        raise JournalError(f"{file}, line 1: {wrong[0]}" if wrong else f"{file}: no events in it")
    if wrong:
        sys.stderr.write(f"{file}: skipped {len(wrong)} lines that are not events\n")
    if is_csv:
        columns = list(dict.fromkeys(chain.from_iterable(map(_flat, events))))
        with out.open("x", encoding="utf-8", newline="") as target:
            # Readable by pandas and spreadsheets.
            table = csv.DictWriter(target, columns, lineterminator="\n")
            table.writeheader()
            # Build the rows again rather than keep them: for a journal of years they would take gigabytes.
            table.writerows(map(_flat, events))
        return
    from touchd.daemon.record import mcap

    with out.open("xb") as messages:
        mcap.write_events(events, messages)


def _flat(event: Event) -> dict[str, Any]:
    """Flatten an event; a field of a mapping gets both names, as in probabilities_pat."""
    row: dict[str, Any] = {}
    for name, value in msgspec.to_builtins(event).items():
        if isinstance(value, dict):
            row |= {f"{name}_{key}": part for key, part in value.items()}
        else:
            row[name] = value
    return row
