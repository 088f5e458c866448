"""Sessions played through the daemon's pipeline: `python -m touchd.model.studies sessions FILE...`.

Prints a line of scores for each file. `--model` names a fold's network, `--people` the people it never saw.
"""

import sys
from collections.abc import Sequence
from pathlib import Path

import msgspec

from touchd.drivers.recording import Recording, Selection, read_recordings, realign
from touchd.model.classifier import SHIPPED_MODEL, Classifier, load_own
from touchd.model.studies.folders import study_parser
from touchd.model.studies.play import frames_of, play
from touchd.model.studies.sessions.plan import SessionSettings, sessions
from touchd.model.studies.sessions.score import SessionScore, judge, score

DISTURBANCES = ("noise", "hum", "motor", "breathing")


def measure(recordings: Sequence[Recording], settings: SessionSettings, model: Classifier) -> SessionScore:
    """Play a session for each person and condition, and score them together."""
    played = sessions(recordings, settings)
    return score([judge(session, play(frames_of(session.counts), model)) for session in played])


def main(arguments: Sequence[str]) -> int:
    """Print the scores of each file; returns 0."""
    parser = study_parser("sessions", "Plays recordings as a pad in use, and scores what the robot is told.")
    parser.add_argument("files", type=Path, nargs="+", help="recordings")
    for name in ("people", "substrate", "cover"):
        parser.add_argument(f"--{name}", default="", help="only these, separated by commas")
    parser.add_argument("--model", type=Path, default=SHIPPED_MODEL, help="an ONNX file; ours without it")
    parser.add_argument("--seconds", type=float, default=6.0, help="length of each touch (%(default)s)")
    parser.add_argument("--as-recorded", action="store_true", help="do not shift the rest after touches")
    for name in DISTURBANCES:
        parser.add_argument(f"--{name}", type=float, default=0.0, help="counts added after 10 s")
    chosen = parser.parse_args(arguments)
    added = {name: getattr(chosen, name) for name in DISTURBANCES}
    settings = SessionSettings(seconds=chosen.seconds, rest_shifts=not chosen.as_recorded, **added)
    listed = (chosen.people, chosen.substrate, chosen.cover)
    select = Selection(*(tuple(text.split(",")) if text else () for text in listed))
    for path in chosen.files:
        recordings = [realign(recording) for recording in read_recordings(path, select)]
        result = measure(recordings, settings, load_own(chosen.model))
        sys.stdout.write(f"{path.name} {msgspec.json.encode(result).decode()}\n")
    return 0
