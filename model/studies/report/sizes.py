"""Our network in other sizes than the shipped one, by the shipped recipe: speed weighed against error.

The sizes were fixed before any of them was trained, and nothing is chosen from their scores: that is why each
may be shown on the test participants.
"""

from collections.abc import Mapping
from pathlib import Path

import msgspec

from touchd.model.settings import LENGTHS
from touchd.model.training.recipe import HAART_RECIPE, Job, Recipe, final_jobs, read_recipe
from touchd.model.training.ship import export_checkpoint
from touchd.model.training.studies import Folders
from touchd.model.training.train import train_studies

# The small ones, kept with the code; large ones are trained on demand.
SIZES_FOLDER = Path(__file__).parents[3] / "model" / "weights" / "haart" / "sizes"
# The shipped network is 96 wide, with a stem of 16.
SHAPES: Mapping[str, Mapping[str, int]] = {
    "touchd-24-wide": {"stem_width": 8, "width": 24, "feed_forward": 48, "dense": 24},
    "touchd-40-wide": {"stem_width": 8, "width": 40, "feed_forward": 80, "dense": 40},
    "touchd-64-wide": {"stem_width": 12, "width": 64, "feed_forward": 128, "dense": 64},
    "touchd-160-wide": {"stem_width": 24, "width": 160, "feed_forward": 320, "dense": 160},
}


def jobs(recipe: Recipe) -> list[Job]:
    """Return one training a size: the shipped network's own, but for the widths."""
    shipped = final_jobs(recipe)[0].settings
    replace = msgspec.structs.replace
    return [
        Job(name, replace(shipped, name=name, network=replace(shipped.network, **shape)))
        for name, shape in SHAPES.items()
    ]


def ready(haart_folder: Path, runs: Path, threads: int, stored: Path = SIZES_FOLDER) -> dict[str, Path]:
    """Return each size's ONNX file, the stored one or the one in `runs`; trains and exports what is missing.

    A training goes on from its last checkpoint.
    """
    files = {}
    for job in jobs(read_recipe(HAART_RECIPE)):
        name = f"{job.name}.onnx"
        path = stored / name
        if not path.exists():
            path = runs / job.name / name
        if not path.exists():
            saved = train_studies(Folders(haart_folder), job.settings, runs / job.name, threads)
            # Uncalibrated: its answers alone count.
            export_checkpoint(saved, path, saved.settings.name, dict.fromkeys(LENGTHS, 1.0))
        files[job.name] = path
    return files
