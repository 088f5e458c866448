"""Recipes: which networks are trained, and on whom.

For the shipped file: one network per seed, on all training participants. For unbiased figures on them: one
per fold, which never sees the fold's participants. For the figure on an unknown pad: one without a study.
"""

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import msgspec
import yaml

from touchd.drivers.errors import TouchdError
from touchd.model.training.settings import Shares, Study, TrainSettings

SHIPPED_RECIPE = Path(__file__).parent / "recipe.yaml"
MAX_BYTES = 64 * 1024


class SettingsError(TouchdError):
    """The training settings are wrong; the message names the key."""


class Recipe(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """The networks that `train` trains."""

    name: str
    folds: tuple[tuple[str, ...], ...]
    """Training participants held out together; each is in exactly one fold."""
    seeds: tuple[int, ...]
    """Seeds of the networks on all training participants; the first network ships."""
    settings: TrainSettings
    left_out_study: Literal["third"] | None = None
    """A study that one network does not learn from, for the figure of a pad never met."""
    most_lost: Shares | None = None
    """The largest share of held-out people's touches that may be answered `other`; sets its logit."""
    begins_from: str | None = None
    """Name of the recipe whose networks the training begins from; None: from random weights."""
    keeps: float = 0.0
    """Share of those networks' weights in the ones that ship, to keep their skill (Wortsman et al. 2022)."""


@dataclass(frozen=True)
class Job:
    """One network to train: its folder, its settings, and the folder of the network that it begins from."""

    name: str
    settings: TrainSettings
    begins_from: str | None = None
    keeps: float = 0.0


def read_recipe(path: Path = SHIPPED_RECIPE) -> Recipe:
    """Read a recipe from YAML. Raises SettingsError, which names the key."""
    try:
        with path.open("rb") as file:
            text = file.read(MAX_BYTES + 1)
        if len(text) > MAX_BYTES:
            raise SettingsError(f"{path}: larger than {MAX_BYTES // 1024} KiB, so not a recipe")
        return msgspec.convert(yaml.safe_load(text), Recipe)
    except (OSError, yaml.YAMLError, msgspec.ValidationError) as error:
        raise SettingsError(f"{path}: {' '.join(str(error).split())}") from error


def fold_name(left_out: tuple[str, ...]) -> str:
    """Return the name of the network that never saw these participants."""
    return f"without-{'-'.join(left_out)}" if left_out else "all"


def final_jobs(recipe: Recipe) -> list[Job]:
    """Return the networks on all training participants, one per seed, the shipped one first."""
    return [_job(recipe, seed) for seed in recipe.seeds]


def fold_jobs(recipe: Recipe) -> list[Job]:
    """Return the networks that hold participants out, one per fold."""
    return [_job(recipe, recipe.seeds[0], left_out=fold) for fold in recipe.folds]


def study_jobs(recipe: Recipe) -> list[Job]:
    """Return the network that leaves a study out, if there is one."""
    left_out = recipe.left_out_study
    return [_job(recipe, recipe.seeds[0], without=left_out)] if left_out else []


def all_jobs(recipe: Recipe) -> list[Job]:
    """Return all networks of a recipe."""
    return [*final_jobs(recipe), *fold_jobs(recipe), *study_jobs(recipe)]


def _job(recipe: Recipe, seed: int, left_out: tuple[str, ...] = (), without: Study | None = None) -> Job:
    settings = msgspec.structs.replace(
        recipe.settings,
        name=recipe.name,
        seed=seed,
        left_out=left_out,
        studies=tuple(study for study in recipe.settings.studies if study != without),
    )
    learnt = f"without-{without}" if without else fold_name(left_out)
    begins_from = f"{recipe.begins_from}-{learnt}-seed{seed}" if recipe.begins_from else None
    return Job(f"{recipe.name}-{learnt}-seed{seed}", settings, begins_from, recipe.keeps)
