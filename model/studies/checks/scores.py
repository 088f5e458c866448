"""Scores of the shipped model on people it never saw: `python -m touchd.model.studies evaluate`.

The challenge's test participants are scored with the shipped file; nothing was chosen on them. Everybody
else is scored with a network of the same recipe that was trained without that person.
"""

import hashlib
import json
import platform
import sys
from collections.abc import Iterator, Mapping
from pathlib import Path
from types import MappingProxyType

import msgspec
from rich.console import Console
from rich.progress import track

from touchd.drivers.errors import TouchdError
from touchd.drivers.frame import FRAME_RATE_HZ
from touchd.model.classifier import SHIPPED_MODEL, Classifier
from touchd.model.settings import LENGTHS
from touchd.model.studies.checks.evaluate import Evaluation, Split, evaluate, score
from touchd.model.studies.published import TABLE3
from touchd.model.training import haart
from touchd.model.training.settings import Study
from touchd.model.training.studies import MISSING, Folders
from touchd.model.training.weights import FABRIC_MODEL, SCORES_NAME, WIDE_MODEL, left_out_split

TITLES: Mapping[str, str] = MappingProxyType(
    {
        "test": "HAART, test participants",
        "left_out": "HAART, training participants",
        "second_study": "second study",
        "third_study": "third study, another kind of pad",
        "new_pad": "third study, a pad never met",
        "cross_study": "second study, trained on HAART alone",
    }
)
"""The sets of people by their fields in `Scores`."""
COMMAND = "python -m touchd.model.studies evaluate --write"
PAPER = "  the paper's (1.50 s: after 1.33 s)"
NEAR = {81: 72}
"""For each of our lengths that the paper does not report, the nearest one that it does."""


FURTHER: Mapping[Study, str] = MappingProxyType(
    {"second": "people who touch the pad around a robot, still or breathing", "third": "another kind of pad"}
)
"""The studies besides HAART, whose recordings are not public, and what each adds."""


class MissingStudyError(TouchdError):
    """The scores of all studies are requested, and the recordings of one do not exist."""


class Scores(msgspec.Struct, frozen=True, kw_only=True):
    """The scores stored beside the shipped model."""

    model: str
    model_sha256: str
    command: str
    machine: str
    labels: tuple[str, ...]
    test: Evaluation
    left_out: Evaluation
    second_study: Evaluation
    third_study: Evaluation
    new_pad: Evaluation
    cross_study: Evaluation


def show(folders: Folders, weights: Path) -> None:
    """Print accuracies at the answered lengths, the paper's too, for the studies whose recordings exist."""
    columns = "".join(f"{length / FRAME_RATE_HZ:8.2f} s" for length in LENGTHS)
    for key, split, missing in splits(folders, weights):
        if key == "test":
            _print(f"Macro accuracy in percent, after{'':6}{columns}")
        live = [(classifier, haart.realigned(recordings)) for classifier, recordings in split]
        rows = [score(live, length, missing=missing) for length in _progress(TITLES[key])]
        _print(_row(TITLES[key], [100 * row.accuracy for row in rows]))
        if key == "test":
            _print(_row(PAPER, [TABLE3[NEAR.get(length, length)] for length in LENGTHS]))
    for study in _not_there(folders):
        _print(f"{study} study: not scored; name its folder with --{study}-study.")
        _print(f"  It adds {FURTHER[study]}.")


def write(folders: Folders, weights: Path) -> Path:
    """Score everything and write scores.json; raises MissingStudyError unless all recordings exist."""
    for study in _not_there(folders):
        raise MissingStudyError(
            f"{_folder(folders, study)}: no such folder; {SCORES_NAME} needs all studies: --{study}-study"
        )
    model = weights / SHIPPED_MODEL.name
    classifier = Classifier.load(model)
    evaluations = {}
    for key, split, missing in splits(folders, weights):
        with Console(stderr=True).status(f"scoring {TITLES[key]}, some minutes"):
            evaluations[key] = evaluate(split, missing)
    scores = Scores(
        model=classifier.name,
        model_sha256=hashlib.sha256(model.read_bytes()).hexdigest(),
        command=COMMAND,
        machine=f"{platform.machine()} {platform.system()}, Python {platform.python_version()}",
        labels=classifier.labels,
        **evaluations,
    )
    path = weights / SCORES_NAME
    write_scores(scores, path)
    return path


def read_scores(path: Path) -> Scores:
    """Read a file of scores."""
    return msgspec.json.decode(path.read_bytes(), type=Scores)


def write_scores(scores: Scores, path: Path) -> None:
    """Write a file of scores, one figure per line, rounded to five digits."""
    rounded = json.loads(msgspec.json.encode(scores), parse_float=lambda figure: round(float(figure), 5))
    path.write_bytes(msgspec.json.format(msgspec.json.encode(rounded), indent=1) + b"\n")


def splits(folders: Folders, weights: Path) -> Iterator[tuple[str, Split, tuple[str, ...]]]:
    """Yield the sets of people that can be scored: key, networks with recordings, gestures they lack."""
    shipped = Classifier.load(weights / SHIPPED_MODEL.name)
    yield "test", [(shipped, haart.read_test(folders.haart))], ()
    yield "left_out", left_out_split(weights, haart.read_training(folders.haart)), ()
    for study in FURTHER:
        if study not in _not_there(folders):
            recordings, missing = folders.to_score_on((study,))[study], MISSING.get(study, ())
            yield f"{study}_study", left_out_split(weights, recordings), missing
            key, other = ("cross_study", WIDE_MODEL) if study == "second" else ("new_pad", FABRIC_MODEL)
            yield key, [(Classifier.load(other), recordings)], missing


def _folder(folders: Folders, study: Study) -> Path:
    return folders.second_study if study == "second" else folders.third_study


def _not_there(folders: Folders) -> list[Study]:
    """Return the studies whose recordings do not exist."""
    return [study for study in FURTHER if not _folder(folders, study).is_dir()]


def _progress(title: str) -> Iterator[int]:
    """Yield the answered lengths, with a progress bar on a terminal."""
    console = Console(stderr=True)
    hidden = not console.is_terminal
    yield from track(LENGTHS, description=title, console=console, transient=True, disable=hidden)


def _row(title: str, percents: list[float]) -> str:
    return f"{title:38}" + "".join(f"{percent:10.1f}" for percent in percents)


def _print(line: str) -> None:
    sys.stdout.write(f"{line}\n")
    sys.stdout.flush()
