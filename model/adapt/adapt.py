"""Adapts the shipped network to a lab's recordings and writes it as a model file of its own.

Accuracy on recordings that were held out is measured before and after.
"""

import hashlib
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from importlib.metadata import version
from pathlib import Path

import msgspec
import numpy as np
import onnx
import torch
from numpy.typing import NDArray
from torch import Tensor, nn
from tqdm import tqdm

from touchd.drivers.errors import os_errors_as
from touchd.drivers.frame import NO_TOUCH, OTHER
from touchd.drivers.recording import Recording
from touchd.drivers.whole_file import whole_file
from touchd.model.adapt.backbone import CropFeatures, Remembered, WindowFeatures, crops, split, windows
from touchd.model.adapt.folder import NO_LABELS, OutputError, check_output, model_name, read_all
from touchd.model.adapt.head import AdaptSettings, fit, one_torch_thread, rebuilt
from touchd.model.adapt.measure import Comparison, Fold, Scored, compare, plan
from touchd.model.classifier import METADATA_KEY, SHIPPED_MODEL, Classifier, ModelMetadata
from touchd.model.settings import AugmentationSettings, NetworkSettings
from touchd.model.tgc import TGC

SETTINGS = AdaptSettings()
# The sources that decide any training's result.
SOURCES = ("adapt/augment.py", "adapt/backbone.py", "adapt/head.py", "tgc.py", "settings.py")
# How many more times `other` is rehearsed if nobody recorded it. After adapting to three people and a gesture
# of their own, 37 % of other people's touches that are none of the gestures are still `other` (44 before);
# without it 17 %.
MORE_OTHER = 3


@dataclass(frozen=True, eq=False)
class Pretrained:
    """The network to adapt: frozen backbone, head, labels, and its rehearsal statistics."""

    labels: tuple[str, ...]
    augmentation: AugmentationSettings
    backbone: TGC
    head: nn.Sequential
    remembered: Remembered

    @classmethod
    def of(cls, model: Path, weights: Mapping[str, Tensor], remembered: Remembered) -> "Pretrained":
        """Load the network of a model file. weights: those that the file was exported from."""
        metadata = Classifier.load(model).metadata
        network = TGC(msgspec.convert(metadata.training["network"], NetworkSettings), len(metadata.labels))
        network.load_state_dict(weights)
        augmentation = msgspec.convert(metadata.training["augmentation"], AugmentationSettings)
        return cls(metadata.labels, augmentation, *split(network.eval()), remembered)

    @classmethod
    def shipped(cls) -> "Pretrained":
        stored = torch.load(SHIPPED_MODEL.with_suffix(".pt"), map_location="cpu", weights_only=True)
        remembered = Remembered.load(SHIPPED_MODEL.with_suffix(".npz"))
        return cls.of(SHIPPED_MODEL, stored["network"], remembered)

    def features(self, recordings: Sequence[Recording], settings: AdaptSettings) -> CropFeatures:
        """Return the features of the recordings from which a head learns."""
        return crops(self.backbone, recordings, self.augmentation, settings.crops, settings.seed)

    def rehearsed(self, labels: Sequence[str], recorded: Collection[str], seed: int) -> CropFeatures:
        """Draw features that stand for other people; `other` more often if nobody recorded it."""
        more = [] if OTHER in recorded else [OTHER] * MORE_OTHER
        return self.remembered.samples([*labels, *more], seed)


@dataclass(frozen=True, eq=False)
class Adapted:
    """A fine-tuned head and its cross-validation.

    known: labels of the pretrained network. passed_over: how many saved touches were not used, by the reason.
    """

    known: tuple[str, ...]
    labels: tuple[str, ...]
    recordings: tuple[Recording, ...]
    head: nn.Sequential
    comparison: Comparison
    passed_over: Mapping[str, int] = field(default_factory=dict)


def adapt_folder(
    extra: Path, output: Path, keep_all: bool = False, labels: Mapping[str, str] = NO_LABELS
) -> Adapted:
    """Adapt the shipped network to a folder of recordings and write it to `output`, a new .onnx file.

    keep_all: keep the known gestures that the folder lacks. labels: see `read_all`. Raises
    ExtraError; raises OutputError before any work if `output` cannot be written.
    """
    check_output(output)
    pretrained = Pretrained.shipped()
    recordings, passed_over = read_all(extra, pretrained.labels, keep_all, labels)
    # One thread makes sums reproducible; a head is too small for more.
    with one_torch_thread():
        adapted = adapt(pretrained, recordings, SETTINGS, keep_all)
    write(adapted, output)
    return replace(adapted, passed_over=passed_over)


def adapt(
    pretrained: Pretrained, recordings: Sequence[Recording], settings: AdaptSettings, keep_all: bool = False
) -> Adapted:
    """Cross-validate, then adapt to all recordings.

    keep_all: keep known gestures without recordings.
    """
    known = pretrained.labels
    # The daemon requires the label "notouch". A network that knows `other` keeps it, recorded or not.
    kept = set(known) if keep_all else {OTHER} & set(known)
    recorded = {recording.gesture for recording in recordings}
    labels = tuple(sorted(recorded | {NO_TOUCH} | kept))
    begin = rebuilt(pretrained.head, known, labels)
    new = sorted(set(labels) - set(known))
    rehearsed = pretrained.rehearsed(labels, recorded, settings.seed)
    features = pretrained.features(recordings, settings)
    left_out, folds = plan(recordings)
    trained = [*(fold.trained for fold in folds), tuple(range(len(recordings)))]
    bar = tqdm(trained, desc="adapting", leave=False, disable=None)
    *heads, head = [fit(begin, labels, new, features.of(own), rehearsed, settings) for own in bar]
    trials = list(zip(heads, folds, strict=True))
    scored = {
        frames: _scored(begin, trials, own, recordings, labels, known)
        for frames, own in windows(pretrained.backbone, recordings).items()
    }
    return Adapted(known, labels, tuple(recordings), head, compare(scored, known, left_out))


def _scored(
    begin: nn.Sequential,
    trials: Sequence[tuple[nn.Sequential, Fold]],
    own: WindowFeatures,
    recordings: Sequence[Recording],
    labels: Sequence[str],
    known: Sequence[str],
) -> list[Scored]:
    """Return the scores of the folds' held-out recordings, on windows of one length."""
    truth = np.array([labels.index(recordings[i].gesture) for i in own.recordings], dtype=np.int64)
    first = logits(begin, own)
    # The pretrained network cannot answer with a new gesture.
    first[:, [label not in known for label in labels]] = -np.inf
    before, scored = first.argmax(axis=1) == truth, []
    for head, fold in trials:
        after = logits(head, own).argmax(axis=1) == truth
        for i in fold.evaluated:
            cut = own.recordings == i
            if cut.any():
                who, gesture = recordings[i].participant, recordings[i].gesture
                scored.append(Scored(who, gesture, float(before[cut].mean()), float(after[cut].mean())))
    return scored


@torch.no_grad()
def logits(head: nn.Sequential, evaluated: WindowFeatures) -> NDArray[np.float64]:
    """Return a head's logits (W, labels) for windows."""
    array: NDArray[np.float64] = head(evaluated.values).numpy().astype(np.float64)
    return array


def write(adapted: Adapted, output: Path) -> None:
    """Atomically write the model with its metadata and scores; raises OutputError."""
    shipped = Classifier.load().metadata
    origin = {
        "from_sha256": hashlib.sha256(SHIPPED_MODEL.read_bytes()).hexdigest(),
        "settings": msgspec.to_builtins(SETTINGS),
        "participants": len({recording.participant for recording in adapted.recordings}),
        "recordings": len(adapted.recordings),
    }
    metadata = msgspec.structs.replace(
        shipped,
        name=model_name(output),
        labels=adapted.labels,
        training={**shipped.training, "adapted": origin},
        code_version=code_version(),
        data_sha256=data_hash(adapted.recordings),
        scores={"adapted": msgspec.to_builtins(adapted.comparison)},
    )
    proto = grafted(SHIPPED_MODEL, adapted.head, metadata)
    with (
        os_errors_as(OutputError, f"{output}: cannot be written"),
        whole_file(output, replace=False) as partial,
    ):
        onnx.save(proto, partial)


def grafted(model: Path, head: nn.Sequential, metadata: ModelMetadata) -> onnx.ModelProto:
    """Return a copy of a model file with an adapted head, which keeps the file's temperatures."""
    proto = onnx.load(model)
    values = {f"calibrated.network.dense.{name}": value for name, value in head.state_dict().items()}
    tensors = {tensor.name: tensor for tensor in proto.graph.initializer}
    for name, value in values.items():
        tensors[name].CopyFrom(onnx.numpy_helper.from_array(value.numpy(), name))
    proto.graph.output[0].type.tensor_type.shape.dim[1].dim_value = len(metadata.labels)
    (entry,) = (entry for entry in proto.metadata_props if entry.key == METADATA_KEY)
    entry.value = msgspec.json.encode(metadata).decode()
    onnx.checker.check_model(proto)
    return proto


def code_version(*more: Path) -> str:
    """Return the installed version and a digest of the sources. more: further sources of a training."""
    digest = hashlib.sha256()
    for path in (*(Path(__file__).parents[1] / name for name in SOURCES), *more):
        digest.update(path.read_bytes())
    return f"{version('touchd')}+{digest.hexdigest()[:12]}"


def data_hash(recordings: Iterable[Recording]) -> str:
    """Return the SHA-256 of all counts (int16, little-endian, in order)."""
    digest = hashlib.sha256()
    for recording in recordings:
        digest.update(recording.counts.astype("<i2").tobytes())
    return digest.hexdigest()
