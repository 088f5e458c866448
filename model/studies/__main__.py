"""Entry point of every study: `python -m touchd.model.studies NAME`, from the repository's root.

A study that measures a table of a page fills that table in and keeps the figures in `stored`.
"""

import importlib
import sys
from collections.abc import Sequence

from touchd.drivers.errors import TouchdError

STUDIES = {
    "data": ("studies.making:data", "downloads the HAART recordings, or checks a folder"),
    "train": ("studies.making:train", "trains the networks of a recipe"),
    "export": ("studies.making:export", "calibrates them and writes them as ONNX files"),
    "detector": ("studies.making:detector", "trains and exports the detectors"),
    "detection": ("studies.tables:detection", "sessions.md: how well the detectors find touches"),
    "evaluate": ("studies.making:evaluate", "scores the shipped model beside the paper's figures"),
    "stability": ("studies.making:stability", "checks a model's arithmetic on hard cases"),
    "accuracy": ("studies.accuracy", "accuracy.md: the stored scores as tables and figures"),
    "challenge": ("studies.challenge.table", "report.md: the challenge's systems, the paper's table 1"),
    "paper": ("studies.paper", "report.md: the paper's network, its table 3"),
    "speed": ("studies.speed", "speed.md: the time of one answer, ours and others'"),
    "decision": ("studies.decision", "decision.md: how early the robot is told, and how often rightly"),
    "adapting": ("studies.adapting", "adapt.md: what adapting to a person gains and costs"),
    "new_pad": ("studies.new_pad", "adapt.md: what recording on another kind of pad gains"),
    "others": ("studies.others", "touches that are none of the gestures, and slow caresses"),
    "passing": (
        "studies.sessions.passing",
        "sessions.md: touches of a second or less, and hands that change",
    ),
    "tables": ("studies.tables", "sessions.md: detection and answers in use, in one file"),
}


def main(arguments: Sequence[str]) -> int:
    """Run a study; returns its exit code, 2 for the user's mistakes."""
    name = arguments[0] if arguments else ""
    if name not in STUDIES:
        listing = "\n".join(f"  {known:<10} {what}" for known, (_, what) in STUDIES.items())
        wrong = f"\n{name} is not one of them\n" if name not in ("", "-h", "--help") else ""
        sys.stderr.write(f"usage: python -m touchd.model.studies NAME [OPTIONS]\n\n{listing}\n{wrong}")
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
