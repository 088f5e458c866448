"""What adapting does on HAART, measured: adapted to a person left out, asked about that person and others.

`python -m docs.studies adapting HAART [DOCS [RUNS]]` writes DOCS/adapt.json, adapt.md and a figure. When
begun again, it goes on where it was cut off. RUNS is `touchd train`'s folder: its networks that leave
participants out are the start for these, and the shipped one for the challenge's test participants.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path

import msgspec
import numpy as np
from torch import nn

from docs.studies.adapting.cells import (
    DRAWS,
    FILE_NAME,
    KS,
    PULLS,
    TEST_PARTICIPANTS,
    Cell,
    NewGesture,
    Pull,
    Study,
    read,
    write,
)
from docs.studies.adapting.pads import other_pads
from docs.studies.adapting.page import write_page
from docs.studies.adapting.score import draw, per_gesture, score, truth_of
from drivers.recording import NO_TOUCH, Recording
from model.adapt.adapt import Start, adapt, learnable, logits, prepare
from model.adapt.backbone import Crops, windows
from model.adapt.head import AdaptSettings, fit, rebuilt
from model.classifier import SHIPPED_MODEL
from model.settings import LENGTHS
from model.training import checkpoint, haart
from model.training.recipe import Recipe, fold_jobs, read_recipe
from model.training.ship import fold_path
from model.training.threads import one_torch_thread
from model.training.train import CHECKPOINT_NAME


class Person:
    """A participant, the others nobody saw, and the network that saw none of them."""

    def __init__(self, start: Start, name: str, unseen: Sequence[Recording]) -> None:
        self.name = name
        self.start = start
        self.recordings = [recording for recording in unseen if recording.participant == name]
        self.windows = windows(start.front, self.recordings)
        self.others = [recording for recording in unseen if recording.participant != name]
        self.other_windows = windows(start.front, self.others)

    def cells(self, number: int, rehearsed: Crops | None, settings: AdaptSettings) -> Iterator[Cell]:
        """Yield what adapting does for one draw, for every number of recordings."""
        first, rest = draw(self.recordings, self.name, number)
        start = self.start
        asked, everybody = np.array(rest), np.arange(len(self.others))
        for each in KS:
            chosen = [self.recordings[i] for own in first for i in own[:each]]
            adapted = adapt(start, prepare(start, chosen, settings), rehearsed, settings)
            last = adapted.comparison.lengths[-1] if adapted.comparison.lengths else None
            before, after = (start.head, start.temperatures), (adapted.head, adapted.temperatures)
            yield Cell(
                participant=self.name,
                draw=number,
                each=each,
                rehearsed=rehearsed is not None,
                own_before=score(*before, self.recordings, self.windows, asked),
                own_after=score(*after, self.recordings, self.windows, asked),
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
        asked, everybody = np.array(rest), np.arange(len(self.others))
        key = str(LENGTHS[-1])

        def scores(head: nn.Sequential) -> tuple[float, float]:
            own = score(head, self.start.temperatures, self.recordings, self.windows, asked)
            others = score(head, self.start.temperatures, self.others, self.other_windows, everybody)
            return own.accuracy[key], others.accuracy[key]

        before = scores(self.start.head)
        for each in KS:
            chosen = [self.recordings[i] for own in first for i in own[:each]]
            shown = prepare(self.start, chosen, settings).shown
            for pull in PULLS:
                other = msgspec.structs.replace(settings, pull=pull)
                after = scores(fit(self.start.head, haart.GESTURES, [], shown, None, other))
                own, others = (round(a - b, 5) for a, b in zip(after, before, strict=True))
                yield Pull(participant=self.name, pull=pull, each=each, own=own, others=others)

    def new_gestures(self, settings: AdaptSettings) -> Iterator[NewGesture]:
        """Yield how each touching gesture is learnt when the last layer has never heard of it."""
        first, rest = draw(self.recordings, self.name, 0)
        length = LENGTHS[-1]
        own = self.windows[length]
        asked = np.isin(own.recordings, rest)
        truth = truth_of(self.recordings, own, asked)
        for each in KS:
            material = prepare(
                self.start, [self.recordings[i] for chosen in first for i in chosen[:each]], settings
            )
            for index, gesture in enumerate(haart.GESTURES):
                if gesture == NO_TOUCH:
                    continue
                known = [name for name in haart.GESTURES if name != gesture]
                blank = rebuilt(rebuilt(self.start.head, haart.GESTURES, known), known, haart.GESTURES)
                head = fit(blank, haart.GESTURES, [gesture], material.shown, None, settings)
                before = logits(blank, own, asked)
                before[:, index] = -np.inf
                after = per_gesture(logits(head, own, asked), truth)
                yield NewGesture(
                    participant=self.name,
                    gesture=gesture,
                    each=each,
                    right=round(float(after[index]), 5),
                    others_before=round(float(np.delete(per_gesture(before, truth), index).mean()), 5),
                    others_after=round(float(np.delete(after, index).mean()), 5),
                )


def people(recipe: Recipe, haart_folder: Path, runs: Path) -> Iterator[tuple[Start, str, list[Recording]]]:
    """Yield the start, name, and recordings of everybody unseen, for each participant that is left out."""
    training = haart.realigned(haart.read_training(haart_folder))
    for job in fold_jobs(recipe, runs):
        left_out = job.settings.left_out
        saved = checkpoint.load(runs / job.name / CHECKPOINT_NAME)
        start = Start.of(saved, fold_path(SHIPPED_MODEL.parent, left_out))
        for name in left_out:
            yield start, name, haart.only(training, left_out)
    test = haart.realigned(haart.read_test(haart_folder))
    for name in TEST_PARTICIPANTS:
        yield Start.shipped(), name, test


def measure(haart_folder: Path, runs: Path, path: Path) -> Study:
    """Measure what is not in the file yet, writing it after each draw; return all."""
    settings = AdaptSettings()
    study = read(path) if path.exists() else Study(settings=settings)
    if study.settings != settings:
        study = Study(settings=settings)
    training = haart.realigned(haart.read_training(haart_folder))
    for start, name, unseen in people(read_recipe(), haart_folder, runs):
        if name not in TEST_PARTICIPANTS and not any(pad.participant == name for pad in study.pads):
            study.pads += other_pads(start, name, unseen, settings)
            write(study, path)
        if name in study.done:
            continue
        person = Person(start, name, unseen)
        seen = haart.without(training, start.saved.settings.left_out)
        for rehearsed in (None, learnable(start, seen, settings)):
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


def main(arguments: Sequence[str]) -> int:
    """Measure what is not measured yet and write the page; returns 0."""
    haart_folder, docs, runs = map(Path, (*arguments, *("docs", "runs")[len(arguments) - 1 :]))
    with one_torch_thread():
        measured = measure(haart_folder, runs, docs / FILE_NAME)
    write_page(measured, docs)
    return 0
