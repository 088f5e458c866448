"""The command line of a study, and the recordings and networks that it names."""

import argparse
import os
from pathlib import Path

from touchd.model.classifier import SHIPPED_MODEL, Classifier
from touchd.model.studies.checks.evaluate import Split
from touchd.model.training import haart
from touchd.model.training.studies import Folders
from touchd.model.training.weights import left_out_split

RECORDINGS = {
    "haart": ("TOUCHD_HAART", "the HAART recordings; `data` fetches them"),
    "second-study": ("TOUCHD_SECOND_STUDY", "the second study's recordings"),
    "third-study": ("TOUCHD_THIRD_STUDY", "the third study's recordings"),
}
STUDIES = tuple(RECORDINGS)
FURTHER = {
    "docs": (Path("docs"), "folder of the pages (docs)"),
    "runs": (Path("runs"), "folder for the trainings' checkpoints (runs)"),
    "weights": (SHIPPED_MODEL.parent, "folder of the model files"),
    "firm-pad": (None, "folder of the firm pad's recordings; without it, no figures of that pad"),
}
TEST, HELD_OUT, SECOND, THIRD = "HAART test", "HAART held out", "second study", "third study"


def study_parser(name: str, description: str | None = None, *takes: str) -> argparse.ArgumentParser:
    """Return a study's parser with options for folders: some of RECORDINGS and FURTHER.

    A folder of recordings defaults to the environment variable, else to its name in the current folder.
    """
    parser = argparse.ArgumentParser(prog=f"python -m touchd.model.studies {name}", description=description)
    for folder in takes:
        if folder in FURTHER:
            default, what = FURTHER[folder]
        else:
            variable, recordings = RECORDINGS[folder]
            default = Path(os.environ.get(variable, folder))
            what = f"folder of {recordings} (default: ${variable}, else {folder})"
        parser.add_argument(f"--{folder}", type=Path, default=default, metavar="FOLDER", help=what)
    return parser


def folders_of(options: argparse.Namespace) -> Folders:
    """Return the folders of recordings that a command line with STUDIES names."""
    return Folders(options.haart, options.second_study, options.third_study)


def never_seen(folders: Folders, weights: Path) -> dict[str, Split]:
    """Return the recordings of TEST, HELD_OUT, SECOND and THIRD, with networks that never saw the people."""
    shipped = Classifier.load(weights / SHIPPED_MODEL.name)
    scored = folders.to_score_on(("haart", "second", "third"))
    held_out = (left_out_split(weights, recordings) for recordings in scored.values())
    test = [(shipped, haart.realigned(haart.read_test(folders.haart)))]
    return dict(zip((TEST, HELD_OUT, SECOND, THIRD), (test, *held_out), strict=True))
