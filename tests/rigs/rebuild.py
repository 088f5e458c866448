"""Rebuilds what is expected of the recordings in tests/recordings, and adds recordings to them.

    make expectations              rebuilds the expected events
    make expectations RECORD=1     first makes again what is simulated
    make expectations ADD=FILE     first adds a recording as a stream

Read the diff before committing it: every changed line is a changed answer.
"""

import argparse
import json
import shutil
import sys
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from rigs import pairs
from rigs.expectations import RECORDINGS, answers, expectation_of, outline, stream_of
from rigs.lines import LINES
from rigs.streams import STREAMS, Sent

from touchd.daemon.app.config import Settings
from touchd.daemon.commands.settings import load_model
from touchd.drivers.recording import read_recordings
from touchd.model.studies.simulated import simulate, write_simulated


def add_stream(path: Path) -> Path:
    """Copy a recording among the streams; raises SystemExit if its name is taken."""
    read_recordings(path)
    new = pairs.FOLDER / path.name
    if new.exists():
        raise SystemExit(f"{new}: is there already; rename {path}")
    shutil.copyfile(path, new)
    return new


def record() -> None:
    """Make again what is simulated, where the file does not hold the same already."""
    for path, (script, seed) in RECORDINGS.items():
        parts = simulate(script, seed)
        made = Sent(*(np.concatenate([getattr(part, name) for part in parts]) for name in Sent._fields))
        if not pairs.holds(path, made):
            path.unlink(missing_ok=True)
            write_simulated(path, script, seed)
    for name in (*STREAMS, *LINES):
        pairs.make(name)


def rebuild() -> None:
    """Write the expected events of every recording, stream and line."""
    classifier = load_model(Settings())
    told = {path: outline(answers(stream_of(path), classifier)) for path in RECORDINGS}
    told |= {path: pairs.told_of(path, classifier) for path in pairs.paths()}
    for path, events in told.items():
        expectation_of(path).write_text("".join(f"{json.dumps(event)}\n" for event in events))


def main(arguments: Sequence[str]) -> None:
    """Rebuild the expected events, if asked after making or adding recordings."""
    parser = argparse.ArgumentParser(description=main.__doc__)
    parser.add_argument("--record", action="store_true", help="make what is simulated again")
    parser.add_argument("--add", type=Path, metavar="FILE", help="a recording (.csv.gz) to add as a stream")
    options = parser.parse_args(arguments)
    if options.record:
        record()
    if options.add:
        add_stream(options.add)
    rebuild()


if __name__ == "__main__":
    main(sys.argv[1:])
