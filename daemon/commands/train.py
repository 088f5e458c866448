"""`touchd train --extra`: adapts the shipped model to recordings of your own; needs the extra `train`."""

import argparse
import json
import sys
from pathlib import Path

from rich.console import Console

from touchd.daemon.sinks.touch_store import labels_in
from touchd.drivers.errors import TouchdError
from touchd.drivers.frame import NO_TOUCH, OTHER
from touchd.model.adapt.folder import check_output, files_of

DESCRIPTION = (
    "Adapts the shipped model to your own recordings: a minute for one person, several "
    "for a dozen. Says how well it does before and after."
)


def add_options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--extra", type=Path, metavar="FOLDER", help="recordings of your own, as `touchd record` makes them"
    )
    parser.add_argument(
        "--output", type=Path, metavar="ONNX", help="the new model's file; touchd-FOLDER.onnx without it"
    )
    parser.add_argument(
        "--keep-all",
        action="store_true",
        help="keep the gestures that the folder lacks, as the shipped model knows them",
    )


def main(options: argparse.Namespace) -> int:
    """Adapt, report, write the new model; returns 0."""
    if options.extra is None:
        raise TouchdError(
            "name your recordings: --extra FOLDER; a recipe's networks are trained by "
            "`python -m touchd.model.studies train`, in the repository"
        )
    output = options.output or Path(f"touchd-{options.extra.resolve().name}.onnx")
    # Report a wrong path before loading torch, which takes seconds.
    files_of(options.extra)
    labels = labels_in(options.extra)
    check_output(output)
    with Console(stderr=True).status("loading torch"):
        import torch  # noqa: F401

        from touchd.model.adapt.adapt import adapt_folder
        from touchd.model.adapt.report import report_lines

    adapted = adapt_folder(options.extra, output, options.keep_all, labels)
    for line in report_lines(adapted):
        sys.stdout.write(f"{line}\n")
    gestures = ", ".join(label for label in adapted.labels if label not in (NO_TOUCH, OTHER))
    sys.stdout.write(
        f"\nWritten: {output}\nTo use it, set in touchd.yaml:\n\n"
        f"model: {json.dumps(str(output.resolve()), ensure_ascii=False)}\n"
        f"scene:\n  gestures: [{gestures}]\n"
    )
    return 0
