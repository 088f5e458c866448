"""What adapting does on HAART: adapted to a person left out, evaluated on that person and on others.

`python -m docs.studies adapting HAART [DOCS [RUNS]]` writes DOCS/adapt.json, the tables of adapt.md and a
picture; run it again to resume. RUNS is `train`'s folder: adapting starts from its networks that left
participants out, and from the shipped one for the challenge's test participants. The other pad is HAART's
with a row of taxels dead, the disturbance that costs the shipped network most.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import msgspec
import numpy as np
from numpy.typing import NDArray
from torch import nn

from docs.studies.adapting import page
from docs.studies.adapting.cells import (
    DRAWS,
    FILE_NAME,
    PULLS,
    SHOTS,
    TEST_PARTICIPANTS,
    Accuracy,
    Measured,
    NewGesture,
    OtherPad,
    Pull,
    Trial,
    read,
    write,
)
from docs.studies.checks.disturb import DISTURBANCES, Disturb
from docs.studies.marked import fill
from docs.studies.training import haart, metrics
from docs.studies.training.recipe import HAART_RECIPE, Recipe, fold_jobs, read_recipe
from docs.studies.training.ship import HAART_MODEL, fold_path
from docs.studies.training.train import CHECKPOINT_NAME
from drivers.recording import NO_TOUCH, Recording
from model.adapt.adapt import Pretrained, adapt, learnable, logits, prepare
from model.adapt.backbone import CropFeatures, WindowFeatures, windows
from model.adapt.head import AdaptSettings, fit, rebuilt
from model.settings import LENGTHS
from model.training import checkpoint
from model.training.threads import one_torch_thread

PADS = ("none", "one dead row")


class Person:
    """A participant, the others nobody saw, and the network that saw none of them."""

    def __init__(self, pretrained: Pretrained, name: str, unseen: Sequence[Recording]) -> None:
        self.name = name
        self.pretrained = pretrained
        self.recordings = [recording for recording in unseen if recording.participant == name]
        self.windows = windows(pretrained.backbone, self.recordings)
        self.others = [recording for recording in unseen if recording.participant != name]
        self.other_windows = windows(pretrained.backbone, self.others)

    def cells(self, number: int, rehearsed: CropFeatures | None, settings: AdaptSettings) -> Iterator[Trial]:
        """Yield what adapting does for one draw, for every number of recordings."""
        first, rest = draw(self.recordings, self.name, number)
        pretrained = self.pretrained
        evaluated, everybody = np.array(rest), np.arange(len(self.others))
        for each in SHOTS:
            chosen = [self.recordings[i] for own in first for i in own[:each]]
            adapted = adapt(pretrained, prepare(pretrained, chosen, settings), rehearsed, settings)
            last = adapted.comparison.lengths[-1] if adapted.comparison.lengths else None
            before, after = (pretrained.head, pretrained.temperatures), (adapted.head, adapted.temperatures)
            yield Trial(
                participant=self.name,
                draw=number,
                each=each,
                rehearsed=rehearsed is not None,
                own_before=score(*before, self.recordings, self.windows, evaluated),
                own_after=score(*after, self.recordings, self.windows, evaluated),
                others_before=score(*before, self.others, self.other_windows, everybody),
                others_after=score(*after, self.others, self.other_windows, everybody),
                told=(
                    None
                    if last is None or last.difference is None or last.interval is None
                    else (last.difference, *last.interval)
                ),
            )

    def pulls(self, settings: AdaptSettings) -> Iterator[Pull]:
        """Yield what each pull would do, for one draw."""
        first, rest = draw(self.recordings, self.name, 0)
        evaluated, everybody = np.array(rest), np.arange(len(self.others))
        key = str(LENGTHS[-1])

        def scores(head: nn.Sequential) -> tuple[float, float]:
            own = score(head, self.pretrained.temperatures, self.recordings, self.windows, evaluated)
            others = score(head, self.pretrained.temperatures, self.others, self.other_windows, everybody)
            return own.accuracy[key], others.accuracy[key]

        before = scores(self.pretrained.head)
        for each in SHOTS:
            chosen = [self.recordings[i] for own in first for i in own[:each]]
            shown = prepare(self.pretrained, chosen, settings).shown
            for pull in PULLS:
                other = msgspec.structs.replace(settings, l2_sp=pull)
                after = scores(fit(self.pretrained.head, haart.GESTURES, [], shown, None, other))
                own, others = (round(a - b, 5) for a, b in zip(after, before, strict=True))
                yield Pull(participant=self.name, pull=pull, each=each, own=own, others=others)

    def new_gestures(self, settings: AdaptSettings) -> Iterator[NewGesture]:
        """Yield how each touching gesture is learnt when the last layer has never heard of it."""
        first, rest = draw(self.recordings, self.name, 0)
        length = LENGTHS[-1]
        own = self.windows[length]
        evaluated = np.isin(own.recordings, rest)
        truth = truth_of(self.recordings, own, evaluated)
        for each in SHOTS:
            material = prepare(
                self.pretrained, [self.recordings[i] for chosen in first for i in chosen[:each]], settings
            )
            for index, gesture in enumerate(haart.GESTURES):
                if gesture == NO_TOUCH:
                    continue
                known = [name for name in haart.GESTURES if name != gesture]
                blank = rebuilt(rebuilt(self.pretrained.head, haart.GESTURES, known), known, haart.GESTURES)
                head = fit(blank, haart.GESTURES, [gesture], material.shown, None, settings)
                before = logits(blank, own, evaluated)
                before[:, index] = -np.inf
                after = per_gesture(logits(head, own, evaluated), truth)
                yield NewGesture(
                    participant=self.name,
                    gesture=gesture,
                    each=each,
                    right=round(float(after[index]), 5),
                    others_before=round(float(np.delete(per_gesture(before, truth), index).mean()), 5),
                    others_after=round(float(np.delete(after, index).mean()), 5),
                )


def people(
    recipe: Recipe, haart_folder: Path, runs: Path
) -> Iterator[tuple[Pretrained, str, list[Recording]]]:
    """Yield pretrained network, name and all unseen recordings for each participant left out."""
    training = haart.realigned(haart.read_training(haart_folder))
    for job in fold_jobs(recipe, runs):
        left_out = job.settings.left_out
        saved = checkpoint.load(runs / job.name / CHECKPOINT_NAME)
        pretrained = Pretrained.of(saved, fold_path(HAART_MODEL.parent, left_out))
        for name in left_out:
            yield pretrained, name, haart.only(training, left_out)
    test = haart.realigned(haart.read_test(haart_folder))
    whole = Pretrained.of(checkpoint.load(HAART_MODEL.with_suffix(".pt")), HAART_MODEL)
    for name in TEST_PARTICIPANTS:
        yield whole, name, test


def measure(haart_folder: Path, runs: Path, path: Path) -> Measured:
    """Measure what is not in the file yet, writing it after each draw; return all."""
    settings = AdaptSettings()
    study = read(path) if path.exists() else Measured(settings=settings)
    if study.settings != settings:
        study = Measured(settings=settings)
    training = haart.realigned(haart.read_training(haart_folder))
    for pretrained, name, unseen in people(read_recipe(HAART_RECIPE), haart_folder, runs):
        if name not in TEST_PARTICIPANTS and not any(pad.participant == name for pad in study.pads):
            study.pads += other_pads(pretrained, name, unseen, settings)
            write(study, path)
        if name in study.done:
            continue
        person = Person(pretrained, name, unseen)
        seen = haart.without(training, pretrained.saved.settings.left_out)
        for rehearsed in (None, learnable(pretrained, seen, settings)):
            for number in range(DRAWS):
                if not study.has(name, number, rehearsed is not None):
                    study.cells += person.cells(number, rehearsed, settings)
                    write(study, path)
        if name not in TEST_PARTICIPANTS:
            study.new_gestures += person.new_gestures(settings)
            study.pulls += person.pulls(settings)
        study.done.append(name)
        write(study, path)
    return study


def other_pads(
    pretrained: Pretrained, name: str, unseen: Sequence[Recording], settings: AdaptSettings
) -> Iterator[OtherPad]:
    """Yield how a participant is answered on each pad before and after adapting to the others of the fold.

    unseen: recordings of everybody whom the network never saw. It is adapted to four recordings a gesture of
    each of the others, and evaluated on all of the participant's.
    """
    chosen = [
        unseen[i]
        for other in sorted({recording.participant for recording in unseen} - {name})
        for own in draw(unseen, other, 0)[0]
        for i in own
    ]
    evaluated = haart.only(unseen, (name,))
    everything = np.arange(len(evaluated))
    for pad in PADS:
        there = [_on_pad(recording, DISTURBANCES[pad]) for recording in evaluated]
        cut = windows(pretrained.backbone, there)
        shown = learnable(
            pretrained, [_on_pad(recording, DISTURBANCES[pad]) for recording in chosen], settings
        )
        head = fit(pretrained.head, haart.GESTURES, [], shown, None, settings)
        yield OtherPad(
            participant=name,
            pad=pad,
            before=score(pretrained.head, pretrained.temperatures, there, cut, everything).accuracy,
            after=score(head, pretrained.temperatures, there, cut, everything).accuracy,
        )


def _on_pad(recording: Recording, disturb: Disturb) -> Recording:
    """Return the recording as another pad would have made it."""
    counts = disturb(recording.counts[np.newaxis].astype(np.float32))[0]
    return replace(recording, counts=np.rint(counts).astype(np.uint16))


def draw(recordings: Sequence[Recording], name: str, number: int) -> tuple[list[list[int]], list[int]]:
    """Return, of a random order of each gesture of a participant, the first four recordings, and the rest."""
    rng = np.random.default_rng([number, *name.encode()])
    first, rest = [], []
    for gesture in haart.GESTURES:
        own = [i for i, each in enumerate(recordings) if (each.participant, each.gesture) == (name, gesture)]
        order = rng.permutation(own).tolist()
        first.append(order[: SHOTS[-1]])
        rest += order[SHOTS[-1] :]
    return first, rest


def score(
    head: nn.Sequential,
    temperatures: Mapping[int, float],
    recordings: Sequence[Recording],
    cut: Mapping[int, WindowFeatures],
    evaluated: NDArray[np.int64],
) -> Accuracy:
    """Return how well a head answers for the windows of the recordings that are evaluated."""
    accuracy, error = {}, 0.0
    for length in LENGTHS:
        chosen = np.isin(cut[length].recordings, evaluated)
        truth = truth_of(recordings, cut[length], chosen)
        answers = logits(head, cut[length], chosen) / temperatures[length]
        predicted = answers.argmax(axis=1).astype(np.int64)
        accuracy[str(length)] = round(metrics.macro_accuracy(predicted, truth, len(haart.GESTURES)), 5)
        odds = np.exp(answers - answers.max(axis=1, keepdims=True))
        error = metrics.expected_calibration_error(odds / odds.sum(axis=1, keepdims=True), truth)
    return Accuracy(accuracy=accuracy, calibration_error=round(error, 5))


def truth_of(
    recordings: Sequence[Recording], cut: WindowFeatures, chosen: NDArray[np.bool_]
) -> NDArray[np.int64]:
    """Return the classes (W,) of chosen windows."""
    return np.array([haart.label(recordings[i]) for i in cut.recordings[chosen]], dtype=np.int64)


def per_gesture(answers: NDArray[np.float64], truth: NDArray[np.int64]) -> NDArray[np.float64]:
    """Return each gesture's share of right answers (7,) from logits (W, 7)."""
    predicted = answers.argmax(axis=1).astype(np.int64)
    return metrics.class_accuracies(predicted, truth, len(haart.GESTURES))


def main(arguments: Sequence[str]) -> int:
    """Measure what is not measured yet and write the page; returns 0."""
    haart_folder, docs, runs = map(Path, (*arguments, *("docs", "runs")[len(arguments) - 1 :]))
    with one_torch_thread():
        measured = measure(haart_folder, runs, docs / FILE_NAME)
    page.draw(measured, docs / "figures" / "adapt.png")
    fill(docs / "adapt.md", page.tables(measured))
    return 0
