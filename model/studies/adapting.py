"""How adapting changes a person's accuracy and others': `python -m touchd.model.studies adapting`."""

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import replace
from operator import attrgetter
from pathlib import Path

import msgspec
import numpy as np
from numpy.typing import NDArray
from torch import nn

from touchd.drivers.recording import Recording
from touchd.model.adapt.adapt import Pretrained, logits
from touchd.model.adapt.backbone import CropFeatures, WindowFeatures, windows
from touchd.model.adapt.head import AdaptSettings, fit, one_torch_thread
from touchd.model.adapt.measure import Floats, mean_interval
from touchd.model.classifier import SHIPPED_MODEL
from touchd.model.studies.folders import STUDIES, folders_of, study_parser
from touchd.model.studies.marked import fill, table
from touchd.model.studies.results import STORED, keep
from touchd.model.training import checkpoint, haart, metrics
from touchd.model.training.calibrate import IMPOSSIBLE
from touchd.model.training.recipe import fold_jobs, read_recipe
from touchd.model.training.ship import remember
from touchd.model.training.studies import MISSING, Folders, study_of
from touchd.model.training.weights import fold_path

SHOTS = (1, 2, 4)
"""How many recordings of each gesture to adapt to. Accuracy is measured on those that no draw uses."""
SHOWN = (1, 4)
"""Those on the page."""
DRAWS = 2
FRAMES = 144
PIECE_FRAMES = 189
"""The third study has two recordings of 12 s per gesture and person; they are cut into pieces of 3.5 s."""
FEW = ("L1", "L2", "S01", "S14")
"""People excluded because they made too few recordings."""
FILE = STORED / "adapt.json"


class Trial(msgspec.Struct, frozen=True, kw_only=True):
    """One network, adapted to `each` recordings per gesture of a person it never saw.

    before, after: macro accuracy on that person's other recordings over 144 frames. others: mean
    gain on the other people it never saw, on the same kind of pad; None if there are none.
    """

    participant: str
    draw: int
    each: int
    before: float
    after: float
    others: float | None


class Measured(msgspec.Struct, frozen=True):
    """The stored figures."""

    settings: AdaptSettings
    trials: tuple[Trial, ...]


class PersonFold:
    """A network, the people it never saw, and its features of their windows."""

    def __init__(self, pretrained: Pretrained, unseen: Sequence[Recording]) -> None:
        self.pretrained = pretrained
        self.unseen = unseen
        self.windows: WindowFeatures = windows(pretrained.backbone, unseen)[FRAMES]
        labels = pretrained.labels
        truth = [labels.index(unseen[i].gesture) for i in self.windows.recordings]
        self.truth = np.array(truth, dtype=np.int64)
        self.people = sorted({recording.participant for recording in unseen})

    def of(self, name: str) -> list[int]:
        """Return the indices of a person's recordings."""
        return [i for i, recording in enumerate(self.unseen) if recording.participant == name]

    def accuracy(self, head: nn.Sequential, recordings: Sequence[int]) -> float:
        """Return macro accuracy over the windows of these recordings."""
        chosen: NDArray[np.bool_] = np.isin(self.windows.recordings, recordings)
        answers = logits(head, self.windows)[chosen]
        for gesture in MISSING.get(study_of(self.unseen[recordings[0]].participant), ()):
            answers[:, self.pretrained.labels.index(gesture)] = IMPOSSIBLE
        predicted = answers.argmax(axis=1).astype(np.int64)
        return metrics.macro_accuracy(predicted, self.truth[chosen], len(self.pretrained.labels))

    def trials(self, name: str, rehearsed: CropFeatures, settings: AdaptSettings) -> Iterator[Trial]:
        """Yield every trial of one person."""
        own, pretrained = self.of(name), self.pretrained
        others = [self.of(other) for other in self.people if other != name and same_kind(other, name)]
        start = pretrained.head
        others_before = [self.accuracy(start, theirs) for theirs in others]
        for number in range(DRAWS):
            drawn = draw(self.unseen, name, number)
            evaluated = sorted(set(own) - {i for first in drawn for i in first})
            before = self.accuracy(start, evaluated)
            for each in SHOTS:
                shown = [self.unseen[i] for first in drawn for i in first[:each]]
                features = pretrained.features(shown, settings)
                head = fit(start, pretrained.labels, [], features, rehearsed, settings)
                after = self.accuracy(head, evaluated)
                gains = [
                    self.accuracy(head, theirs) - was
                    for theirs, was in zip(others, others_before, strict=True)
                ]
                yield Trial(
                    participant=name,
                    draw=number,
                    each=each,
                    before=round(before, 4),
                    after=round(after, 4),
                    others=round(float(np.mean(gains)), 4) if gains else None,
                )


def same_kind(one: str, other: str) -> bool:
    """Whether two people touched the same kind of pad: HAART's and the second study's are fabric."""
    return (study_of(one) == "third") == (study_of(other) == "third")


def pieces(recordings: Iterable[Recording]) -> list[Recording]:
    """Cut recordings into pieces of PIECE_FRAMES; a shorter remainder is dropped."""
    return [
        replace(
            each,
            counts=each.counts[start : start + PIECE_FRAMES],
            sensor_ms=each.sensor_ms[start : start + PIECE_FRAMES],
        )
        for each in recordings
        for start in range(0, len(each.counts) - PIECE_FRAMES + 1, PIECE_FRAMES)
    ]


def draw(recordings: Sequence[Recording], name: str, number: int) -> list[list[int]]:
    """Return, for each gesture, four random recordings of one person, by their indices."""
    rng = np.random.default_rng([number, *name.encode()])
    whose = [(each.participant, each.gesture) for each in recordings]
    return [
        rng.permutation([i for i, each in enumerate(whose) if each == (name, gesture)]).tolist()[: SHOTS[-1]]
        for gesture in haart.GESTURES
    ]


def networks(folders: Folders) -> Iterator[tuple[tuple[str, ...], Pretrained]]:
    """Yield the people of each fold, and the network that never saw them."""
    for job in fold_jobs(read_recipe()):
        left_out = job.settings.left_out
        yield left_out, to_adapt(fold_path(SHIPPED_MODEL.parent, left_out), folders)


def to_adapt(path: Path, folders: Folders) -> Pretrained:
    """Return the network of a model file, to adapt, with the statistics that it is rehearsed with."""
    saved = checkpoint.restored(path)
    return Pretrained.of(path, saved.network, remember(saved, folders))


def measure(folders: Folders, settings: AdaptSettings) -> Iterator[Trial]:
    """Yield the trials of everybody in the three studies."""
    takes = [*folders.to_train_on(("haart", "second")), *pieces(folders.to_train_on(("third",)))]
    for left_out, network in networks(folders):
        fold = PersonFold(network, haart.only(takes, left_out))
        rehearsed = network.rehearsed(network.labels, haart.GESTURES, settings.seed)
        for name in fold.people:
            if name not in FEW:
                yield from fold.trials(name, rehearsed, settings)


def tables(measured: Measured) -> dict[str, str]:
    """Return the page's tables by their places."""
    rows = []
    for group, letter in (("third study", "S"), ("second study", "R"), ("HAART", "P")):
        for each in SHOWN:
            cell = [t for t in measured.trials if t.participant.startswith(letter) and t.each == each]
            interval = mean_interval(_by_person(cell, lambda t: t.after - t.before))
            assert interval is not None
            before, after = (_by_person(cell, attrgetter(name)).mean() for name in ("before", "after"))
            gains = [(trial.participant, trial.others) for trial in cell if trial.others is not None]
            others = np.mean(
                [np.mean([gain for who, gain in gains if who == name]) for name in {*dict(gains)}]
            )
            gained = f"{100 * interval[0]:+.1f} to {100 * interval[1]:+.1f}"
            shown = (f"{100 * before:.1f}", f"**{100 * after:.1f}**", gained, f"{100 * others:+.1f}")
            rows.append((group, each, *shown))
    headings = ("people", "a gesture", "before", "after", "95 % of the difference", "others")
    return {"summary": table(headings, rows)}


def _by_person(trials: Sequence[Trial], figure: Callable[[Trial], float]) -> Floats:
    """Return each person's mean of a figure."""
    names = sorted({trial.participant for trial in trials})
    return np.array([np.mean([figure(t) for t in trials if t.participant == name]) for name in names])


def main(arguments: Sequence[str]) -> int:
    """Measure everybody and fill the page; returns 0."""
    options = study_parser("adapting", __doc__, *STUDIES, "docs").parse_args(arguments)
    settings = AdaptSettings()
    with one_torch_thread():
        measured = Measured(settings, tuple(measure(folders_of(options), settings)))
    keep(FILE, measured)
    fill(options.docs / "adapt.md", tables(measured))
    return 0
