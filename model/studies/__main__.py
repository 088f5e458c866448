"""Entry point of every study: `python -m touchd.model.studies NAME`, from the repository's root."""

import importlib
import sys
from collections.abc import Sequence

from touchd.drivers.errors import TouchdError

STUDIES = {
    "data": ("training.commands:data", "downloads the HAART recordings, or checks a folder"),
    "train": ("training.commands:train", "trains the networks of a recipe"),
    "export": ("training.commands:export", "calibrates them and writes them as ONNX files"),
    "evaluate": ("training.commands:evaluate", "scores the shipped model beside the paper's figures"),
    "stability": ("training.commands:stability", "checks a model's arithmetic on hard cases"),
    "seeds": ("studies.seeds", "scores the recipe with three seeds"),
    "accuracy": ("studies.accuracy", "fills docs/accuracy.md from the stored scores"),
    "challenge": ("studies.challenge.table", "reimplements the challenge's systems: the paper's table 1"),
    "paper": ("studies.paper", "trains the paper's network: its tables 2 and 3"),
    "speed": ("studies.speed", "times one answer, ours and others', against its error"),
    "decision": ("studies.decision", "how early and how often the robot is told the right answer"),
    "adapting": ("studies.adapting", "what adapting to a person gains and costs"),
    "tracker": ("studies.tracker.report", "how well touches are detected"),
    "sessions": ("studies.sessions.report", "what the robot is told of a pad in use, touch after touch"),
    "joined": ("studies.sessions.joined", "what the robot is told of two gestures without a pause"),
}


def main(arguments: Sequence[str]) -> int:
    """Run a study; returns its exit code, 2 for the user's mistakes."""
    name = arguments[0] if arguments else ""
    if name not in STUDIES:
        listing = "\n".join(f"  {known:<10} {what}" for known, (_, what) in STUDIES.items())
        sys.stderr.write(f"usage: python -m touchd.model.studies NAME [OPTIONS]\n\n{listing}\n")
        return 2
    module, _, function = STUDIES[name][0].partition(":")
    try:
        return int(
            getattr(importlib.import_module(f"touchd.model.{module}"), function or "main")(arguments[1:]) or 0
        )
    except ModuleNotFoundError as error:
        sys.stderr.write(
            f"{name}: {error.name} is not installed: {sys.executable} -m pip install -e '.[dev]'\n"
        )
        return 2
    except TouchdError as error:
        sys.stderr.write(f"{name}: {error}\n")
        return 2


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
