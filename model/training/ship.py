"""Makes the shipped files from a recipe: trains what is missing, calibrates, exports."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import compress
from pathlib import Path
from types import MappingProxyType
from typing import Any

import msgspec
import numpy as np
import torch

from touchd.drivers.frame import FRAME_RATE_HZ, NO_TOUCH, OTHER
from touchd.drivers.recording import Recording
from touchd.model.adapt.backbone import Remembered, crops, split
from touchd.model.classifier import SHIPPED_MODEL, ModelMetadata, digest_file, digest_of
from touchd.model.settings import LENGTHS
from touchd.model.training import calibrate, checkpoint, haart, unknown
from touchd.model.training.checkpoint import Checkpoint
from touchd.model.training.export import export
from touchd.model.training.recipe import Job, Recipe, all_jobs, final_jobs, fold_jobs, fold_name, study_jobs
from touchd.model.training.refine import as_other, refine
from touchd.model.training.remember import save as save_remembered
from touchd.model.training.remember import statistics
from touchd.model.training.settings import Study
from touchd.model.training.studies import Folders
from touchd.model.training.train import CHECKPOINT_NAME, fastest_device, train
from touchd.model.training.weights import FABRIC_MODEL, LEFT_OUT_FOLDER, SEEDS_FOLDER, fold_path

MAX_LENGTH = 432
"""The longest window, in frames, that an exported file takes."""
REMEMBERED_CROPS = 3
"""Crops of each recording from which the rehearsal statistics are computed."""
REMEMBERED_MADE = 96
"""Simulated touches that are none of the gestures, per fabric study, in the same statistics."""


def train_recipe(
    recipe: Recipe, folders: Folders, runs: Path, threads: int, begin_from: Path | None = None
) -> None:
    """Train every network of the recipe that is not finished in `runs` yet.

    On a GPU, networks at the same step train side by side; on a CPU, one after another.
    begin_from: a folder of model files to begin from, for networks that are not in `runs`.
    """
    torch.set_num_threads(threads)
    if recipe.settings.refined is not None:
        _refine_all(recipe, folders, runs, begin_from)
        return
    device = fastest_device()
    recordings = folders.to_train_on(recipe.settings.studies)
    unfinished: dict[tuple[int, str], list[Job]] = {}
    for job in all_jobs(recipe):
        if (step := _steps_done(job, runs)) < job.settings.steps:
            unfinished.setdefault((step, "" if device == "cuda" else job.name), []).append(job)
    for jobs in unfinished.values():
        train(recordings, jobs, runs, device)


def _refine_all(recipe: Recipe, folders: Folders, runs: Path, begin_from: Path | None) -> None:
    studies = recipe.settings.studies
    recordings = [*folders.to_train_on(studies), *as_other(folders.others(studies))]
    for job in all_jobs(recipe):
        if _steps_done(job, runs) < job.settings.steps:
            refine(recordings, job, _first(job, runs, begin_from), runs)


def _first(job: Job, runs: Path, begin_from: Path | None) -> Checkpoint:
    """Return the network that a job begins from: its checkpoint, or else its model file in `begin_from`."""
    path = runs / str(job.begins_from) / CHECKPOINT_NAME
    if path.exists() or begin_from is None:
        return checkpoint.load(path)
    if left_out := job.settings.left_out:
        return checkpoint.restored(fold_path(begin_from, left_out))
    is_whole = "third" in job.settings.studies
    return checkpoint.restored(begin_from / (SHIPPED_MODEL if is_whole else FABRIC_MODEL).name)


def _steps_done(job: Job, runs: Path) -> int:
    path = runs / job.name / CHECKPOINT_NAME
    return _saved(job, runs).step if path.exists() else 0


def _saved(job: Job, runs: Path) -> Checkpoint:
    """Return a job's checkpoint; raises CheckpointError if it was made with other settings."""
    saved = checkpoint.load(runs / job.name / CHECKPOINT_NAME)
    if saved.settings != job.settings:
        raise checkpoint.CheckpointError(
            f"{runs / job.name}: made with other settings than the recipe's; choose another --runs"
        )
    return saved


@dataclass(frozen=True, eq=False)
class Trained:
    """A recipe's networks with what their export needs.

    learnt: recordings by study. folds: the networks that held people out. answers: of each fold, about the
    people of each study whom it held out.
    """

    recipe: Recipe
    folders: Folders
    runs: Path
    learnt: Mapping[Study, Sequence[Recording]]
    folds: Sequence[Checkpoint]
    answers: Sequence[Sequence[calibrate.Answers]]

    @classmethod
    def of(cls, recipe: Recipe, folders: Folders, runs: Path) -> "Trained":
        """Load the folds and compute their answers; raises CheckpointError if a training has not ended."""
        scored = folders.to_score_on(recipe.settings.studies)
        folds = [finished(job, runs) for job in fold_jobs(recipe)]
        return cls(
            recipe,
            folders,
            runs,
            {study: folders.to_train_on((study,)) for study in recipe.settings.studies},
            folds,
            [[calibrate.ask_left_out(fold, study) for study in scored.values()] for fold in folds],
        )


@dataclass(frozen=True)
class Calibration:
    """Temperatures, and a shift of the logit of `other`; fitted on held-out people."""

    temperatures: dict[int, float]
    shift: float = 0.0

    def of(self, saved: Checkpoint) -> Checkpoint:
        """Return a network with the shift applied."""
        return saved.shifted(OTHER, self.shift) if self.shift else saved


def export_recipe(recipe: Recipe, folders: Folders, runs: Path, weights: Path) -> list[Path]:
    """Export the shipped network, and one file per further seed, fold and left-out study; return the paths.

    The shipped network's checkpoint and rehearsal statistics are written beside it, for adapting it.
    Each fold's temperatures are fitted on the other folds, so that its calibration error is unbiased.
    """
    trained = Trained.of(recipe, folders, runs)
    written = _export_folds(trained, weights)
    for stale in {*(weights / LEFT_OUT_FOLDER).glob("*.onnx")} - {*written}:
        stale.unlink()
    return [*written, *_export_left_out_study(trained, weights), *_export_final(trained, weights)]


def _export_folds(trained: Trained, weights: Path) -> list[Path]:
    written = []
    for fold, own in zip(trained.folds, trained.answers, strict=True):
        path = fold_path(weights, fold.settings.left_out)
        name = f"{trained.recipe.name}-{fold_name(fold.settings.left_out)}"
        fitted = _calibrated(trained.recipe, [answer for answer in trained.answers if answer is not own])
        accuracies = calibrate.accuracies(_shifted(own, fold.labels, fitted.shift))
        _export(fitted.of(fold), name, trained.learnt, fitted.temperatures, accuracies, path)
        written.append(path)
    return written


def _export_left_out_study(trained: Trained, weights: Path) -> list[Path]:
    written = []
    for job in study_jobs(trained.recipe):
        saved = finished(job, trained.runs)
        path = weights / FABRIC_MODEL.name
        met = [study in saved.settings.studies for study in trained.learnt]
        fitted = _calibrated(trained.recipe, [list(compress(answer, met)) for answer in trained.answers], met)
        name = f"{trained.recipe.name}-fabric"
        _export(fitted.of(saved), name, trained.learnt, fitted.temperatures, {}, path)
        written.append(path)
    return written


def _export_final(trained: Trained, weights: Path) -> list[Path]:
    recipe, answers = trained.recipe, trained.answers
    fitted = _calibrated(recipe, answers)
    written = []
    for job in final_jobs(recipe):
        saved = fitted.of(finished(job, trained.runs))
        held_out = [answer for fold in answers for answer in _shifted(fold, saved.labels, fitted.shift)]
        accuracies = calibrate.accuracies(held_out) if held_out else {}
        is_shipped = job.settings.seed == recipe.seeds[0]
        further = Path(SEEDS_FOLDER, f"seed{job.settings.seed}.onnx")
        path = weights / (SHIPPED_MODEL.name if is_shipped else further)
        _export(saved, recipe.name, trained.learnt, fitted.temperatures, accuracies, path)
        written += [path, *(_export_beside(saved, trained.folders, path) if is_shipped else ())]
    return written


def _shifted(
    answers: Sequence[calibrate.Answers], labels: Sequence[str], shift: float
) -> list[calibrate.Answers]:
    return [calibrate.shifted(answer, labels, shift) for answer in answers]


def _export_beside(saved: Checkpoint, folders: Folders, path: Path) -> list[Path]:
    """Write the shipped network's checkpoint, rehearsal statistics and digest beside it."""
    beside, remembered, digest = path.with_suffix(".pt"), path.with_suffix(".npz"), digest_file(path)
    checkpoint.save(replace(saved, training={}), beside)
    save_remembered(remember(saved, folders), remembered)
    digest.write_text(f"{digest_of(path.read_bytes())}\n")
    return [beside, remembered, digest]


def remember(saved: Checkpoint, folders: Folders) -> Remembered:
    """Return rehearsal statistics of each study that a network learnt from."""
    settings = saved.settings
    backbone, _ = split(saved.build())
    learnt = [
        [*haart.without(folders.to_train_on((study,)), settings.left_out), *_others(saved, folders, study)]
        for study in settings.studies
    ]
    return statistics(
        [crops(backbone, own, settings.augmentation, REMEMBERED_CROPS, seed=0) for own in learnt]
    )


def _others(saved: Checkpoint, folders: Folders, study: Study) -> list[Recording]:
    """Return a study's touches that are none of the gestures: recorded, or simulated for a fabric pad."""
    if OTHER not in saved.labels:
        return []
    if study == "third":
        return as_other(haart.without(folders.others((study,)), saved.settings.left_out))
    known = haart.without(folders.to_train_on((study,)), saved.settings.left_out)
    rests = [recording for recording in known if recording.gesture == NO_TOUCH]
    rng = np.random.default_rng(saved.settings.seed)
    return [unknown.on_rest(rng, rests[rng.integers(len(rests))]) for _ in range(REMEMBERED_MADE)]


def _calibrated(
    recipe: Recipe, answers: Sequence[Sequence[calibrate.Answers]], met: Sequence[bool] | None = None
) -> Calibration:
    """Return the calibration from each fold's answers, one entry per study; the identity without folds.

    met: which of the recipe's studies the answers are about; None: all.
    """
    if not answers:
        return Calibration(dict.fromkeys(LENGTHS, 1.0))
    studies, shift = recipe.settings.studies, 0.0
    if recipe.most_lost is not None:
        learnt = compress(studies, met or [True] * len(studies))
        most = [getattr(recipe.most_lost, study) for study in learnt]
        shift = calibrate.fit_shift([*zip(*answers, strict=True)], haart.LABELS, most)
        answers = [_shifted(fold, haart.LABELS, shift) for fold in answers]
    fitted = (calibrate.fit_temperatures(study) for study in zip(*answers, strict=True))
    return Calibration(calibrate.highest(fitted), shift)


def _export(
    saved: Checkpoint,
    name: str,
    learnt: Mapping[Study, Sequence[Recording]],
    temperatures: Mapping[int, float],
    accuracies: dict[str, float],
    path: Path,
) -> None:
    learnt_from = {
        study: sorted({each.participant for each in haart.without(recordings, saved.settings.left_out)})
        for study, recordings in learnt.items()
        if study in saved.settings.studies
    }
    export_checkpoint(
        saved, path, name, temperatures, {"learnt_from": learnt_from}, {"left_out_accuracy": accuracies}
    )


def export_checkpoint(
    saved: Checkpoint,
    path: Path,
    name: str,
    temperatures: Mapping[int, float],
    training: Mapping[str, Any] = MappingProxyType({}),
    scores: Mapping[str, Any] = MappingProxyType({}),
) -> None:
    """Write a trained network. training: metadata to add to its training settings."""
    metadata = ModelMetadata(
        name=name,
        labels=saved.labels,
        frame_rate_hz=FRAME_RATE_HZ,
        framing="live",
        lengths=LENGTHS,
        max_length=MAX_LENGTH,
        temperatures={str(length): round(value, 4) for length, value in temperatures.items()},
        training={**msgspec.to_builtins(saved.settings), **training},
        code_version=saved.code_version,
        data_sha256=saved.data_sha256,
        scores=dict(scores),
    )
    export(saved.build(), metadata, path)


def finished(job: Job, runs: Path) -> Checkpoint:
    """Return a trained network, with its share of the one it began from; raises CheckpointError.

    Its training must have ended.
    """
    saved = _saved(job, runs)
    if saved.step < job.settings.steps:
        raise checkpoint.CheckpointError(
            f"{runs / job.name}: stopped after step {saved.step}; run `train` again"
        )
    # A refined network has been saved with its share.
    if job.begins_from is None or not job.keeps or job.settings.refined is not None:
        return saved
    first = checkpoint.load(runs / job.begins_from / CHECKPOINT_NAME).network
    blended = {name: torch.lerp(own, first[name], job.keeps) for name, own in saved.network.items()}
    return replace(saved, network=blended)
