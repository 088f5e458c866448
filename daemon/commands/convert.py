"""`touchd convert`: a journal or a recording as CSV or MCAP."""

import argparse
import csv
import sys
from collections.abc import Sequence
from itertools import chain
from pathlib import Path
from typing import Any

import msgspec

from touchd.daemon.events import Event
from touchd.daemon.kept.journal import JournalError
from touchd.daemon.kept.touches import read_events
from touchd.drivers.errors import TouchdError
from touchd.drivers.recording import SUFFIXES, read_provenance, read_recordings, realign, write_recordings
from touchd.drivers.whole_file import PRIVATE_MODE, whole_file


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
        import touchd.daemon.convert.mcap  # noqa: F401
    try:
        with whole_file(out, replace=False, mode=PRIVATE_MODE) as partial:
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
        # Our own layout holds whole scans.
        write_recordings(out, list(map(realign, recordings)), read_provenance(file))
        return
    from touchd.daemon.convert import mcap

    with out.open("xb") as target:
        mcap.write_recordings(recordings, target)


def _convert_journal(file: Path, out: Path) -> None:
    # Read once: a running daemon may write on, and begin another file.
    events, wrong = read_events(file)
    if not events:
        raise JournalError(f"{file}, line 1: {wrong[0]}" if wrong else f"{file}: no events in it")
    if wrong:
        sys.stderr.write(f"{file}: left out {len(wrong)} lines that are no events\n")
    if out.suffix == ".csv":
        columns = list(dict.fromkeys(chain.from_iterable(map(_flat, events))))
        with out.open("x", encoding="utf-8", newline="") as target:
            # For pandas and spreadsheets.
            table = csv.DictWriter(target, columns, lineterminator="\n")
            table.writeheader()
            # Made twice, for all rows at once take gigabytes for a journal of years.
            table.writerows(map(_flat, events))
        return
    from touchd.daemon.convert import mcap

    with out.open("xb") as messages:
        mcap.write_events(events, messages)


def _flat(event: Event) -> dict[str, Any]:
    """Return an event's fields by name; those of a mapping are called by both names: probabilities_pat."""
    row: dict[str, Any] = {}
    for name, value in msgspec.to_builtins(event).items():
        if isinstance(value, dict):
            row |= {f"{name}_{key}": part for key, part in value.items()}
        else:
            row[name] = value
    return row
