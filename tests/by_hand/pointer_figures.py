"""Measures how often touches with a mouse or fingers on the live page are named rightly.

Pointers move as a visitor's do (rigs/visitors.py); the daemon's pipeline reads the simulated pad under them.

PYTHONPATH=.:tests python tests/by_hand/pointer_figures.py [--model FILE.onnx] [--tries 32]
"""

import argparse
import sys
from collections import Counter
from pathlib import Path

from rigs.visitors import KINDS, counts_of, named

from touchd.model.classifier import Classifier


def main() -> None:
    """Print a row for each kind of touch."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--model", type=Path, help="a network; the shipped one without it")
    parser.add_argument("--tries", type=int, default=32)
    options = parser.parse_args()
    model = Classifier.load(options.model) if options.model else Classifier.load()
    sys.stdout.write(
        f"{model.name}, {options.tries} tries a row\n\n| touch | right | otherwise |\n|---|---|---|\n"
    )
    for kind in KINDS:
        names = Counter(named(model, counts_of(kind, seed)) for seed in range(options.tries))
        right = 100 * names[kind.gesture] / options.tries
        others = ", ".join(
            f"{name} {100 * count / options.tries:.0f}"
            for name, count in names.most_common()
            if name != kind.gesture
        )
        sys.stdout.write(f"| {kind.name} | {right:.0f} | {others} |\n")


if __name__ == "__main__":
    main()
