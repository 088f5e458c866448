"""How far the figures of people left out depend on the seed (docs/accuracy.md).

The recipe's folds are trained again with other seeds, and each answers the people that it never saw.
"""

from collections.abc import Sequence

import msgspec
import numpy as np

from docs.studies.accuracy import ONE_OUT, PLACES, SEEDS
from docs.studies.marked import fill, table
from docs.studies.training.calibrate import accuracies, ask_left_out
from docs.studies.training.one_out import PAGE, TITLES, read_options
from docs.studies.training.recipe import fold_jobs, read_recipe
from docs.studies.training.ship import trained
from docs.studies.training.studies import Folders
from model.settings import LENGTHS

SHOWN_SEEDS = (0, 1, 2)


def main(arguments: Sequence[str]) -> int:
    """Train what is not trained yet, score it, fill the page's table; returns 0."""
    options = read_options("seeds", __doc__, arguments)
    recipe, folders = read_recipe(), Folders(options.haart, options.second_study)
    scored = folders.to_score_on(recipe.settings.studies)
    networks = {
        seed: [
            trained(job, folders, options.runs, options.threads)
            for job in fold_jobs(msgspec.structs.replace(recipe, seeds=(seed,)))
        ]
        for seed in SHOWN_SEEDS
    }
    rows = []
    for study, held in scored.items():
        shares = [accuracies([ask_left_out(fold, held) for fold in folds]) for folds in networks.values()]
        percents = 100 * np.array([[share[str(length)] for length in LENGTHS] for share in shares])
        title = f"{TITLES[study]} left out"
        for seed, row in zip(SHOWN_SEEDS, percents, strict=True):
            rows.append((title, seed, *(f"{percent:.1f}" for percent in row)))
        spread = zip(percents.mean(axis=0), percents.std(axis=0, ddof=1), strict=True)
        rows.append(
            (title, "mean ± sd", *(f"**{mean:.1f}** ± {deviation:.1f}" for mean, deviation in spread))
        )
    headings = ("", "seed", *(f"{length} frames" for length in LENGTHS))
    fill(PAGE, {SEEDS: table(headings, rows)}, others=(*PLACES, ONE_OUT))
    return 0
