"""Adapts the shipped network to a lab's recordings, with held-out accuracy before and after."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn
from tqdm import tqdm

from touchd.drivers.frame import NO_TOUCH, OTHER
from touchd.drivers.recording import Recording
from touchd.model.adapt.backbone import BAR, CropFeatures, WindowFeatures, crops, ended, split, windows
from touchd.model.adapt.head import AdaptSettings, fit, rebuilt
from touchd.model.adapt.measure import Answers, Comparison, compare, cross_entropy
from touchd.model.adapt.plan import Fold, plan
from touchd.model.adapt.remembered import Remembered
from touchd.model.classifier import SHIPPED_MODEL, Classifier
from touchd.model.settings import LENGTHS, AugmentationSettings, NetworkSettings
from touchd.model.tgc import TGC

TEMPERATURES = np.geomspace(0.3, 5.0, 200)
# Prior standard deviation of the log of a temperature around the shipped one.
TEMPERATURE_SPREAD = 0.3


@dataclass(frozen=True, eq=False)
class Pretrained:
    """The network to adapt: frozen backbone, head, metadata, and its rehearsal statistics."""

    labels: tuple[str, ...]
    training: Mapping[str, Any]
    augmentation: AugmentationSettings
    temperatures: dict[int, float]
    backbone: TGC
    head: nn.Sequential
    remembered: Remembered

    @classmethod
    def of(cls, model: Path, weights: Mapping[str, Tensor], remembered: Remembered) -> "Pretrained":
        """Load the network of a model file. weights: those that the file was exported from."""
        metadata = Classifier.load(model).metadata
        network = TGC(msgspec.convert(metadata.training["network"], NetworkSettings), len(metadata.labels))
        network.load_state_dict(weights)
        backbone, head = split(network.eval())
        return cls(
            metadata.labels,
            metadata.training,
            msgspec.convert(metadata.training["augmentation"], AugmentationSettings),
            {int(length): value for length, value in metadata.temperatures.items()},
            backbone,
            head,
            remembered,
        )

    @classmethod
    def shipped(cls) -> "Pretrained":
        stored = torch.load(SHIPPED_MODEL.with_suffix(".pt"), map_location="cpu", weights_only=True)
        remembered = Remembered.load(SHIPPED_MODEL.with_suffix(".npz"))
        return cls.of(SHIPPED_MODEL, stored["network"], remembered)


@dataclass(frozen=True, eq=False)
class Adapted:
    """A fine-tuned head and its cross-validation.

    known: labels of the pretrained network. passed_over: how many saved touches were not learnt from, by the
    reason.
    """

    known: tuple[str, ...]
    labels: tuple[str, ...]
    recordings: tuple[Recording, ...]
    head: nn.Sequential
    temperatures: dict[int, float]
    comparison: Comparison
    passed_over: Mapping[str, int] = field(default_factory=dict)


@dataclass(frozen=True, eq=False)
class Features:
    """Recordings with the backbone's features of their crops and windows, and of ended touches in passing."""

    recordings: Sequence[Recording]
    shown: CropFeatures
    windows: dict[int, WindowFeatures]
    ended: WindowFeatures


def prepare(pretrained: Pretrained, recordings: Sequence[Recording], settings: AdaptSettings) -> Features:
    """Compute features of crops to train on and of windows to evaluate."""
    return Features(
        recordings,
        crops(pretrained.backbone, recordings, pretrained.augmentation, settings.crops, settings.seed),
        windows(pretrained.backbone, recordings),
        ended(pretrained.backbone, recordings),
    )


def adapt(
    pretrained: Pretrained, material: Features, settings: AdaptSettings, keep_all: bool = False
) -> Adapted:
    """Cross-validate, then adapt to all recordings.

    keep_all: keep known gestures without recordings.
    """
    gestures = {recording.gesture for recording in material.recordings}
    known = pretrained.labels
    # The daemon requires the label "notouch". A network that knows `other` keeps it, recorded or not.
    kept = set(known) if keep_all else {OTHER} & set(known)
    labels = tuple(sorted(gestures | {NO_TOUCH} | kept))
    begin = rebuilt(pretrained.head, known, labels)
    new = sorted(set(labels) - set(known))
    rehearsed = pretrained.remembered.samples(labels, settings.seed)

    def learnt(chosen: Sequence[int]) -> nn.Sequential:
        return fit(begin, labels, new, material.shown.of(chosen), rehearsed, settings)

    planned = plan(material.recordings)
    everything = tuple(range(len(material.recordings)))
    shown = [*(fold.trained for fold in planned.folds), everything]
    bar = tqdm(shown, desc="adapting", bar_format=BAR, leave=False, disable=None)
    *heads, head = [learnt(chosen) for chosen in bar]
    is_new = [label in new for label in labels]
    turns = list(zip(heads, planned.folds, strict=True))
    cut = material.windows | {0: material.ended}
    answers = {length: _answers(begin, is_new, turns, own) for length, own in cut.items()}
    temperatures = {
        length: _temperature(answers[length], material.recordings, labels, pretrained.temperatures[length])
        for length in LENGTHS
    }
    comparison = compare(answers, material.recordings, labels, known, planned.left_out)
    return Adapted(known, labels, tuple(material.recordings), head, temperatures, comparison)


def _answers(
    begin: nn.Sequential,
    is_new: Sequence[bool],
    turns: Sequence[tuple[nn.Sequential, Fold]],
    own: WindowFeatures,
) -> Answers:
    """Return logits of held-out windows before and after adapting.

    is_new: for each label, whether the pretrained network lacks it.
    """
    nothing = np.zeros((0, len(is_new)))
    owners, befores, afters = [own.recordings[:0]], [nothing], [nothing]
    for head, fold in turns:
        evaluated = np.isin(own.recordings, fold.evaluated)
        owners.append(own.recordings[evaluated])
        befores.append(logits(begin, own, evaluated))
        afters.append(logits(head, own, evaluated))
    before = np.concatenate(befores)
    before[:, is_new] = -np.inf
    return Answers(np.concatenate(owners), before, np.concatenate(afters))


@torch.no_grad()
def logits(head: nn.Sequential, evaluated: WindowFeatures, chosen: NDArray[np.bool_]) -> NDArray[np.float64]:
    """Return a head's logits (W, labels) for chosen windows."""
    array: NDArray[np.float64] = head(evaluated.values[torch.from_numpy(chosen)]).numpy().astype(np.float64)
    return array


def _temperature(
    answers: Answers, recordings: Sequence[Recording], labels: Sequence[str], pretrained: float
) -> float:
    """Return the MAP temperature for held-out answers; with few of them the prior keeps the pretrained one.

    Windows of a recording are correlated, so a recording counts as one answer.
    """
    truth = np.array([labels.index(recordings[i].gesture) for i in answers.recordings], dtype=np.int64)
    count = len(np.unique(answers.recordings))

    def unlikeliness(temperature: float) -> float:
        prior = 0.5 * (np.log(temperature / pretrained) / TEMPERATURE_SPREAD) ** 2
        return float(prior + (count * cross_entropy(answers.after / temperature, truth) if count else 0.0))

    return float(min([pretrained, *TEMPERATURES], key=unlikeliness))
