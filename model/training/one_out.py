"""How well the recipe does on a person when it learnt from nearly everybody else (docs/accuracy.md).

A fold's network has never seen a third of the people. Here each goes on learning, from all of them but one of
each study, and is scored on that one: nearer to the shipped network, which learnt from everybody.
"""

import argparse
from collections.abc import Callable, Iterator, Sequence
from itertools import zip_longest
from pathlib import Path

import msgspec
import numpy as np
import torch

from touchd.drivers.recording import Recording
from touchd.model.settings import LENGTHS
from touchd.model.studies.accuracy import ONE_OUT, PLACES, SEEDS
from touchd.model.studies.folders import study_parser
from touchd.model.studies.marked import fill, table
from touchd.model.training import checkpoint, haart
from touchd.model.training.calibrate import accuracies, ask, ask_left_out
from touchd.model.training.checkpoint import Checkpoint
from touchd.model.training.recipe import Job, Recipe, final_jobs, fold_jobs, read_recipe
from touchd.model.training.settings import Study
from touchd.model.training.ship import trained
from touchd.model.training.studies import Folders
from touchd.model.training.train import CHECKPOINT_NAME, Training, fastest_device, train

PAGE = Path(__file__).parents[2] / "docs" / "accuracy.md"
TITLES: dict[Study, str] = {"haart": "HAART, training participants", "second": "second study"}
FRAMES = tuple(f"{length} frames" for length in LENGTHS)
SEEDS_DESCRIPTION = """How far the figures of people left out depend on the seed (docs/accuracy.md).

The recipe's networks are trained again with other seeds, and each answers the people that it never saw.
"""
SHOWN_SEEDS = (0, 1, 2)
EPOCHS = 12
LEARNING_RATE = 0.001


def left_out_together(fold: Sequence[str]) -> Iterator[tuple[str, ...]]:
    """Yield the people of a fold one of each study at a time."""
    studies = [[name for name in fold if name.startswith(letter)] for letter in "RP"]
    for together in zip_longest(*studies):
        yield tuple(name for name in together if name)


def go_on(
    saved: Checkpoint, left_out: tuple[str, ...], recordings: Sequence[Recording], runs: Path
) -> Checkpoint:
    """Return the network after it learnt from everybody but these; resumes what is in `runs`."""
    name = f"{saved.settings.name}-one-out-{'-'.join(left_out)}"
    settings = msgspec.structs.replace(
        saved.settings,
        name=name,
        left_out=left_out,
        epochs=EPOCHS,
        rate_epochs=EPOCHS,
        averaged_epochs=(),
        learning_rate=LEARNING_RATE,
    )
    learnt = haart.without(recordings, left_out)
    if not (path := runs / name / CHECKPOINT_NAME).exists():
        training = Training(learnt, settings, fastest_device())
        for network in (training.network, training.average):
            network.load_state_dict(saved.network)
        checkpoint.save(training.snapshot(), path)
    return train(learnt, settings, path.parent, fastest_device())


def main(arguments: Sequence[str]) -> int:
    """Train what is not trained yet, score it, fill the page's table; returns 0."""
    recipe, folders, options = _read("one-out", __doc__, arguments)
    torch.set_num_threads(options.threads)
    recordings = folders.to_train_on(recipe.settings.studies)
    networks = [
        go_on(fold, left_out, recordings, options.runs)
        for job in fold_jobs(recipe)
        for fold in [checkpoint.load(options.runs / job.name / CHECKPOINT_NAME)]
        for left_out in left_out_together(job.settings.left_out)
    ]
    rows = []
    for study, held in folders.to_score_on(recipe.settings.studies).items():
        asked = [network for network in networks if haart.only(held, network.settings.left_out)]
        shares = accuracies([ask_left_out(network, held) for network in asked])
        rows.append((TITLES[study], *(f"**{100 * shares[str(length)]:.1f}**" for length in LENGTHS)))
    fill(PAGE, {ONE_OUT: table(("one left out of each study", *FRAMES), rows)}, others=(*PLACES, SEEDS))
    return 0


def seeds(arguments: Sequence[str]) -> int:
    """Train the networks with other seeds where that is not done yet, score them, fill the page's table."""
    recipe, folders, options = _read("seeds", SEEDS_DESCRIPTION, arguments)
    recipes = [msgspec.structs.replace(recipe, seeds=(seed,)) for seed in SHOWN_SEEDS]

    def networks(jobs: Callable[[Recipe], list[Job]]) -> list[list[Checkpoint]]:
        return [
            [trained(job, folders, options.runs, options.threads) for job in jobs(each)] for each in recipes
        ]

    shipped, left_out = networks(final_jobs), networks(fold_jobs)
    test = haart.realigned(haart.read_test(folders.haart))
    scored = {"HAART, test participants": [accuracies([ask(each, test)]) for (each,) in shipped]}
    for study, held in folders.to_score_on(recipe.settings.studies).items():
        scored[f"{TITLES[study]} left out"] = [
            accuracies([ask_left_out(fold, held) for fold in folds]) for folds in left_out
        ]
    rows: list[tuple[object, ...]] = []
    for title, shares in scored.items():
        percents = 100 * np.array([[share[str(length)] for length in LENGTHS] for share in shares])
        for seed, row in zip(SHOWN_SEEDS, percents, strict=True):
            rows.append((title, seed, *(f"{percent:.1f}" for percent in row)))
        spread = zip(percents.mean(axis=0), percents.std(axis=0, ddof=1), strict=True)
        rows.append(
            (title, "mean ± sd", *(f"**{mean:.1f}** ± {deviation:.1f}" for mean, deviation in spread))
        )
    fill(PAGE, {SEEDS: table(("", "seed", *FRAMES), rows)}, others=(*PLACES, ONE_OUT))
    return 0


def _read(
    name: str, description: str | None, arguments: Sequence[str]
) -> tuple[Recipe, Folders, argparse.Namespace]:
    parser = study_parser(name, description, "haart", "second-study")
    parser.add_argument("--runs", type=Path, default=Path("runs"), help="the recipe's checkpoints (runs)")
    parser.add_argument("--threads", type=int, default=1, help="processor threads (1)")
    options = parser.parse_args(arguments)
    return read_recipe(), Folders(options.haart, options.second_study), options
