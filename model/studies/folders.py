"""The command line of a study, with the options for folders."""

import argparse
import os
from pathlib import Path

RECORDINGS = {
    "haart": ("TOUCHD_HAART", "the HAART recordings; `data` fetches them"),
    "second-study": ("TOUCHD_SECOND_STUDY", "the second study's recordings"),
    "third-study": ("TOUCHD_THIRD_STUDY", "the third study's recordings"),
}


def study_parser(name: str, description: str | None = None, *takes: str) -> argparse.ArgumentParser:
    """Return a study's parser with options for folders: "docs", and those of RECORDINGS.

    A folder of recordings defaults to the environment variable, else to its name in the current folder.
    """
    parser = argparse.ArgumentParser(prog=f"python -m touchd.model.studies {name}", description=description)
    for folder in takes:
        if folder == "docs":
            default, what = Path("docs"), "folder of the pages (docs)"
        else:
            variable, recordings = RECORDINGS[folder]
            default = Path(os.environ.get(variable, folder))
            what = f"folder of {recordings} (default: ${variable}, else {folder})"
        parser.add_argument(f"--{folder}", type=Path, default=default, metavar="FOLDER", help=what)
    return parser
