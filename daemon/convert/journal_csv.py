"""A journal as a table: a row an event, a column each field, for pandas and spreadsheets."""

import csv
from collections.abc import Callable, Iterable
from typing import IO, Any

import msgspec

from daemon.events import Event


def write(events: Callable[[], Iterable[Event]], file: IO[str]) -> None:
    """Write the table. events: gives the events anew each time, as they are read twice."""
    columns: dict[str, None] = {}
    for event in events():
        columns.update(dict.fromkeys(_flat(event)))
    table = csv.DictWriter(file, list(columns), lineterminator="\n")
    table.writeheader()
    for event in events():
        table.writerow(_flat(event))


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
