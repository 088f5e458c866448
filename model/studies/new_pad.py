"""What a lab with another kind of pad gains by recording on it: `python -m touchd.model.studies new_pad`.

Two tables of adapt.md. The first adapts the network that learnt from the fabric pads alone to people on
the third study's pad, which it has never met. The second adds two gestures to networks that know the pad
but not the people.
"""

from collections.abc import Iterator, Sequence
from itertools import groupby

import msgspec
import numpy as np
from numpy.typing import NDArray
from torch import nn

from touchd.drivers.recording import Recording
from touchd.model.adapt.adapt import Pretrained, logits
from touchd.model.adapt.backbone import windows
from touchd.model.adapt.head import AdaptSettings, fit, one_torch_thread, rebuilt
from touchd.model.studies.adapting import networks, to_adapt
from touchd.model.studies.folders import STUDIES, folders_of, study_parser
from touchd.model.studies.marked import fill, percent, table
from touchd.model.studies.results import STORED, keep
from touchd.model.training import haart, metrics, third_study
from touchd.model.training.calibrate import IMPOSSIBLE
from touchd.model.training.studies import MISSING, Folders
from touchd.model.training.weights import FABRIC_MODEL

PEOPLE = (1, 3, 6, 9)
DRAWS = 6
"""Random draws for each number of people; everybody who is not drawn is scored."""
NEW = ("poke", "tap")
FRAMES = (54, 81, 144)
FILE = STORED / "new_pad.json"


class Learnt(msgspec.Struct, frozen=True, kw_only=True):
    """The fabric network adapted to some people: macro accuracy on everybody else's recordings, by length."""

    people: tuple[str, ...]
    after: tuple[float, ...]


class Added(msgspec.Struct, frozen=True, kw_only=True):
    """Accuracy at one length on the people whom a fold holds out, after adding the new gestures.

    new: of each new gesture. third, fabric: macro accuracy of the known gestures, before and after.
    """

    fold: tuple[str, ...]
    frames: int
    new: tuple[float, ...]
    third: tuple[float, float]
    fabric: tuple[float, float]


class Measured(msgspec.Struct, frozen=True):
    """The stored figures. untaught: macro accuracy of the unadapted fabric network, by length."""

    settings: AdaptSettings
    untaught: tuple[float, ...]
    learnt: tuple[Learnt, ...]
    added: tuple[Added, ...]


class Scored:
    """A backbone's summaries of the recordings' windows, with the true gestures and people."""

    def __init__(
        self, pretrained: Pretrained, recordings: Sequence[Recording], labels: Sequence[str]
    ) -> None:
        self.labels = tuple(labels)
        self.windows = windows(pretrained.backbone, recordings)
        self.people = np.array([recording.participant for recording in recordings])
        self.truth = np.array(
            [self.labels.index(recording.gesture) for recording in recordings], dtype=np.int64
        )

    def shares(
        self, head: nn.Sequential, frames: int, people: Sequence[str], missing: Sequence[str] = ()
    ) -> NDArray[np.float64]:
        """Return the accuracy for each label (labels,), nan for a gesture that these people never made.

        missing: labels that are not among the answers.
        """
        cut = self.windows[frames]
        chosen = np.isin(self.people[cut.recordings], people)
        answers = logits(head, cut)[chosen]
        answers[:, [self.labels.index(label) for label in missing]] = IMPOSSIBLE
        truth = self.truth[cut.recordings[chosen]]
        return metrics.class_accuracies(answers.argmax(axis=1).astype(np.int64), truth, len(self.labels))


def people_on_a_new_pad(folders: Folders, settings: AdaptSettings) -> tuple[tuple[float, ...], list[Learnt]]:
    """Return the fabric network's accuracy on the new pad, unadapted and adapted to some of its people."""
    pretrained = to_adapt(FABRIC_MODEL, folders)
    recordings = folders.to_train_on(("third",))
    labels = pretrained.labels
    scored = Scored(pretrained, recordings, labels)
    shown = pretrained.features(recordings, settings)
    rehearsed = pretrained.rehearsed(labels, haart.GESTURES, settings.seed)
    everybody = sorted(set(scored.people.tolist()))

    def accuracies(head: nn.Sequential, people: Sequence[str]) -> tuple[float, ...]:
        each = (scored.shares(head, frames, people, MISSING["third"]) for frames in FRAMES)
        return tuple(round(float(np.nanmean(shares)), 4) for shares in each)

    learnt = []
    for count in PEOPLE:
        for number in range(DRAWS):
            taught = sorted(np.random.default_rng([count, number]).permutation(everybody)[:count].tolist())
            own = [i for i, name in enumerate(scored.people) if name in taught]
            head = fit(pretrained.head, labels, [], shown.of(own), rehearsed, settings)
            others = [name for name in everybody if name not in taught]
            learnt.append(Learnt(people=tuple(taught), after=accuracies(head, others)))
    return accuracies(pretrained.head, everybody), learnt


def two_gestures_more(folders: Folders, settings: AdaptSettings) -> Iterator[Added]:
    """Yield each fold's figures after adding tap and poke, recorded by the people it was trained on."""
    third = third_study.read(folders.third_study, NEW)
    fabric = folders.to_train_on(("haart", "second"))
    for left_out, pretrained in networks(folders):
        labels = tuple(sorted({*pretrained.labels, *NEW}))
        start = rebuilt(pretrained.head, pretrained.labels, labels)
        shown = pretrained.features(haart.without(third, left_out), settings)
        rehearsed = pretrained.rehearsed(labels, haart.GESTURES, settings.seed)
        head = fit(start, labels, NEW, shown, rehearsed, settings)
        on_third = Scored(pretrained, haart.only(third, left_out), labels)
        on_fabric = Scored(pretrained, haart.only(fabric, left_out), labels)
        known = [labels.index(label) for label in haart.GESTURES]
        for frames in FRAMES:
            before = on_third.shares(start, frames, left_out, (*MISSING["third"], *NEW))[known]
            after = on_third.shares(head, frames, left_out, MISSING["third"])
            home = (
                on_fabric.shares(start, frames, left_out, NEW)[known],
                on_fabric.shares(head, frames, left_out)[known],
            )
            yield Added(
                fold=left_out,
                frames=frames,
                new=tuple(round(float(after[labels.index(label)]), 4) for label in NEW),
                third=(_mean(before), _mean(after[known])),
                fabric=(_mean(home[0]), _mean(home[1])),
            )


def tables(measured: Measured) -> dict[str, str]:
    """Return the page's tables by their places."""
    rows: list[tuple[object, ...]] = [("nobody", *map(percent, measured.untaught))]
    for count, draws in groupby(measured.learnt, lambda learnt: len(learnt.people)):
        after = np.array([learnt.after for learnt in draws]).mean(axis=0)
        rows.append((count, *map(percent, after)))
    changed: list[tuple[object, ...]] = []
    for frames in FRAMES:
        folds = [added for added in measured.added if added.frames == frames]
        new = np.array([added.new for added in folds]).mean(axis=0)
        pairs = [
            np.array([getattr(added, pad) for added in folds]).mean(axis=0) for pad in ("third", "fabric")
        ]
        changed.append(
            (
                f"{frames / 54:.2g} s",
                *map(percent, new),
                *(f"{percent(b)} → {percent(a)}" for b, a in pairs),
            )
        )
    return {
        "new-pad": table(("people recorded on the pad", "after 1 s", "after 1.5 s", "after 2.67 s"), rows),
        "new-gestures": table(("after", *NEW, "the others, third pad", "the others, fabric pads"), changed),
    }


def _mean(shares: NDArray[np.float64]) -> float:
    return round(float(np.nanmean(shares)), 4)


def main(arguments: Sequence[str]) -> int:
    """Measure and fill the page; returns 0."""
    options = study_parser("new_pad", __doc__, *STUDIES, "docs").parse_args(arguments)
    settings, folders = AdaptSettings(), folders_of(options)
    with one_torch_thread():
        untaught, learnt = people_on_a_new_pad(folders, settings)
        added = tuple(two_gestures_more(folders, settings))
    measured = Measured(settings, untaught, tuple(learnt), added)
    keep(FILE, measured)
    fill(options.docs / "adapt.md", tables(measured))
    return 0
