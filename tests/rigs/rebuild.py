"""Rebuilds what is expected of the recordings in tests/recordings, and adds recordings to them.

    make expectations              rebuilds the expected events
    make expectations ADD=FILE     first adds a recording as a stream

Read the diff before committing it: every changed line is a changed answer.
"""

import argparse
import json
import shutil
import sys
from collections.abc import Sequence
from pathlib import Path

from rigs import pairs
from rigs.expectations import RECORDINGS, answers, expectation_of, outline, stream_of

from touchd.daemon.app.config import Settings
from touchd.daemon.commands.settings import load_model
from touchd.drivers.recording import read_recordings


def add_stream(path: Path) -> Path:
    """Copy a recording among the streams; raises SystemExit if its name is taken."""
    read_recordings(path)
    new = pairs.FOLDER / path.name
    if new.exists():
        raise SystemExit(f"{new}: is there already; rename {path}")
    shutil.copyfile(path, new)
    return new


def rebuild() -> None:
    """Write the expected events of every recording, stream and line."""
    classifier = load_model(Settings())
    told = {path: outline(answers(stream_of(path), classifier)) for path in RECORDINGS}
    told |= {path: pairs.told_of(path, classifier) for path in pairs.paths()}
    for path, events in told.items():
        expectation_of(path).write_text("".join(f"{json.dumps(event)}\n" for event in events))


def main(arguments: Sequence[str]) -> None:
    """Rebuild the expected events, if asked after adding a recording."""
    parser = argparse.ArgumentParser(description=main.__doc__)
    parser.add_argument("--add", type=Path, metavar="FILE", help="a recording (.csv.gz) to add as a stream")
    options = parser.parse_args(arguments)
    if options.add:
        add_stream(options.add)
    rebuild()


if __name__ == "__main__":
    main(sys.argv[1:])
