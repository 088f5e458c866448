"""The entry to every study: `python -m touchd.model.studies NAME`, from the repository's root."""

import importlib
import sys
from collections.abc import Sequence

from touchd.drivers.errors import TouchdError

STUDIES = {
    "data": ("training.commands:data", "fetches the HAART recordings, or checks a folder"),
    "train": ("training.commands:train", "trains the networks of a recipe"),
    "export": ("training.commands:export", "calibrates them and writes them as ONNX files"),
    "evaluate": ("training.commands:evaluate", "scores the shipped model"),
    "seeds": ("training.one_out:seeds", "scores the recipe with other seeds"),
    "one-out": ("training.one_out", "scores the recipe with one person of each study left out"),
    "stability": ("training.commands:stability", "checks a model's arithmetic on hard cases"),
    "accuracy": ("studies.accuracy", "rewrites the accuracy page from the stored scores"),
    "report": ("studies.report.page", "the paper's tables and figures beside ours"),
    "stages": ("studies.stages", "where the time goes from a frame's last byte to the robot"),
    "speed": ("studies.speed", "times an answer against the paper's network"),
    "adapting": ("studies.adapting", "what adapting to a person gains and costs"),
    "sessions": ("studies.sessions.report", "what the robot hears of a pad in use, touch after touch"),
    "joined": ("studies.sessions.joined", "what the robot hears of two gestures without a pause"),
    "pads": ("studies.pads", "how the answers fare on pads other than the lab's, simulated"),
    "tracker": ("studies.tracker.report", "how well touches are noticed"),
    "early": ("studies.decision.early", "how early one can tell, by which stopping rule"),
    "decision": ("studies.decision.report", "how early and how often the daemon is right"),
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
