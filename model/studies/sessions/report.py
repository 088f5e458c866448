"""Sessions of all people, played flat out through the daemon's own pipeline.

`python -m touchd.model.studies sessions FILE... [--people P3,P4] [--substrate static] [--cover none]
[--model FOLD.onnx] [--seconds 3] [--as-recorded] [--noise 1.5] [--hum 2] [--motor 2] [--breathing 2]`
prints a line a file.
"""

import argparse
import sys
from collections.abc import Callable, Sequence
from pathlib import Path

import msgspec

from touchd.drivers.recording import Recording, Selection, read_recordings, realign
from touchd.model.classifier import SHIPPED_MODEL, Classifier
from touchd.model.studies.folders import study_parser
from touchd.model.studies.play import frames_of, play
from touchd.model.studies.sessions.plan import SessionSettings, sessions
from touchd.model.studies.sessions.score import SessionScore, judge, score


def measure(recordings: Sequence[Recording], settings: SessionSettings, model: Classifier) -> SessionScore:
    """Play a session a person and condition, and score all of them together."""
    played = sessions(recordings, settings)
    return score([judge(session, play(frames_of(session.counts), model)) for session in played])


def add_choice(parser: argparse.ArgumentParser) -> None:
    """Add whose recordings are played, and which model is asked."""
    parser.add_argument("files", type=Path, nargs="+")
    for name in ("people", "substrate", "cover"):
        parser.add_argument(f"--{name}", default="", help="only these, with commas between")
    parser.add_argument("--model", type=Path, default=SHIPPED_MODEL)


def print_scores(
    chosen: argparse.Namespace, measure: Callable[[Sequence[Recording], Classifier], msgspec.Struct]
) -> None:
    """Print a line a file with what is measured on the chosen recordings."""

    def those(text: str) -> tuple[str, ...]:
        return tuple(text.split(",")) if text else ()

    select = Selection(those(chosen.people), those(chosen.substrate), those(chosen.cover))
    for path in chosen.files:
        recordings = [realign(recording) for recording in read_recordings(path, select)]
        result = measure(recordings, Classifier.load(chosen.model))
        sys.stdout.write(f"{path.name} {msgspec.json.encode(result).decode()}\n")


def main(arguments: Sequence[str]) -> int:
    """Print the scores; returns 0."""
    parser = study_parser("sessions")
    add_choice(parser)
    parser.add_argument("--seconds", type=float, default=6.0)
    parser.add_argument("--as-recorded", action="store_true")
    disturbances = ("noise", "hum", "motor", "breathing")
    for name in disturbances:
        parser.add_argument(f"--{name}", type=float, default=0.0, help="counts")
    chosen = parser.parse_args(arguments)
    added = {name: getattr(chosen, name) for name in disturbances}
    settings = SessionSettings(seconds=chosen.seconds, rest_shifts=not chosen.as_recorded, **added)
    print_scores(chosen, lambda recordings, model: measure(recordings, settings, model))
    return 0
