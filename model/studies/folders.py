"""The command line of a study, with the folders that several studies take."""

import argparse
import os
from pathlib import Path

RECORDINGS = {
    "haart": ("TOUCHD_HAART", "the HAART recordings; `data` fetches them"),
    "second-study": ("TOUCHD_SECOND_STUDY", "the second study's robot-pad.csv"),
}


def study_parser(name: str, description: str | None = None, *takes: str) -> argparse.ArgumentParser:
    """Return the parser of a study that takes some of these folders: "haart", "second-study", "docs".

    Recordings are by default where the environment's variable says, else in ./haart and ./second-study.
    """
    parser = argparse.ArgumentParser(prog=f"python -m touchd.model.studies {name}", description=description)
    for folder in takes:
        if folder == "docs":
            default, what = Path("docs"), "of the page (docs)"
        else:
            variable, recordings = RECORDINGS[folder]
            default = Path(os.environ.get(variable, folder))
            what = f"folder of {recordings} (default: ${variable}, else {folder})"
        parser.add_argument(f"--{folder}", type=Path, default=default, metavar="FOLDER", help=what)
    return parser
