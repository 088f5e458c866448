"""How much scores depend on the seed: `python -m touchd.model.studies seeds`.

Trains the recipe's networks with other seeds, unless that is done; each is scored on people it never saw.
"""

import sys
from collections.abc import Callable, Sequence
from pathlib import Path

import msgspec
import numpy as np

from touchd.model.settings import LENGTHS
from touchd.model.studies.folders import study_parser
from touchd.model.training import haart
from touchd.model.training.calibrate import accuracies, ask, ask_left_out
from touchd.model.training.checkpoint import Checkpoint
from touchd.model.training.recipe import Job, Recipe, final_jobs, fold_jobs, read_recipe
from touchd.model.training.ship import finished, train_recipe
from touchd.model.training.studies import Folders

SEEDS = (0, 1, 2)


def main(arguments: Sequence[str]) -> int:
    """Train what is not trained yet, and print mean and standard deviation over the seeds; returns 0."""
    parser = study_parser("seeds", __doc__, "haart", "second-study", "third-study")
    parser.add_argument("--runs", type=Path, default=Path("runs"), help="the recipe's checkpoints (runs)")
    parser.add_argument("--threads", type=int, default=1, help="processor threads (1)")
    options = parser.parse_args(arguments)
    recipe, folders = read_recipe(), Folders(options.haart, options.second_study, options.third_study)
    recipes = [msgspec.structs.replace(recipe, seeds=(seed,), left_out_study=None) for seed in SEEDS]
    for each in recipes:
        train_recipe(each, folders, options.runs, options.threads)

    def networks(jobs: Callable[[Recipe], list[Job]]) -> list[list[Checkpoint]]:
        return [[finished(job, options.runs) for job in jobs(each)] for each in recipes]

    shipped, held_out = networks(final_jobs), networks(fold_jobs)
    test = haart.realigned(haart.read_test(folders.haart))
    _show("HAART, test participants", [accuracies([ask(each, test)]) for (each,) in shipped])
    for study, held in folders.to_score_on(recipe.settings.studies).items():
        _show(
            f"{study}, held out",
            [accuracies([ask_left_out(fold, held) for fold in folds]) for folds in held_out],
        )
    return 0


def _show(title: str, shares: Sequence[dict[str, float]]) -> None:
    percents = 100 * np.array([[share[str(length)] for length in LENGTHS] for share in shares])
    spread = zip(LENGTHS, percents.mean(axis=0), percents.std(axis=0, ddof=1), strict=True)
    figures = "  ".join(f"{length} frames {mean:.1f} ± {deviation:.1f}" for length, mean, deviation in spread)
    sys.stdout.write(f"{title:26}{figures}\n")
