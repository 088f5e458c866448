"""Checkpoints: a network, its provenance, and the state for resuming its training."""

import zipfile
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any

import msgspec
import onnx
import torch
from torch import Tensor

from touchd.drivers.errors import TouchdError
from touchd.drivers.whole_file import whole_file
from touchd.model.classifier import METADATA_KEY, ModelMetadata
from touchd.model.tgc import TGC
from touchd.model.training.settings import TrainSettings

# The widest network's checkpoint takes 14 MB.
MAX_FILE_BYTES = 128 * 1024 * 1024
ADVICE = "make one with `python -m touchd.model.studies train`"


class CheckpointError(TouchdError):
    """A checkpoint is missing, damaged, or belongs to another training."""


@dataclass(frozen=True)
class Checkpoint:
    """One training's state after `step` steps.

    network: the averaged weights, for use.
    training: raw weights, optimizer and random states, for resuming; empty in a shipped file.
    """

    settings: TrainSettings
    labels: tuple[str, ...]
    step: int
    network: dict[str, Tensor]
    training: dict[str, Any]
    code_version: str
    data_sha256: str

    def shifted(self, label: str, shift: float) -> "Checkpoint":
        """Return a copy with a shift added to a label's logit."""
        name = max(name for name in self.network if name.startswith("dense.") and name.endswith(".bias"))
        bias = self.network[name].clone()
        bias[self.labels.index(label)] += shift
        return replace(self, network={**self.network, name: bias})

    def build(self) -> TGC:
        """Return the averaged network in evaluation mode."""
        network = TGC(self.settings.network, len(self.labels))
        network.load_state_dict(self.network)
        return network.eval()


def save(checkpoint: Checkpoint, path: Path) -> None:
    """Atomically write the checkpoint."""
    path.parent.mkdir(parents=True, exist_ok=True)
    stored = {field.name: getattr(checkpoint, field.name) for field in fields(Checkpoint)}
    stored["settings"] = msgspec.json.encode(checkpoint.settings).decode()
    with whole_file(path) as partial:
        torch.save(stored, partial)


def restored(model: Path) -> Checkpoint:
    """Return the network of an exported file as a checkpoint to begin from; raises CheckpointError.

    The exporter folds some weights into others and transposes some; this undoes it, up to rounding.
    """
    try:
        proto = onnx.load(model)
        (entry,) = (each for each in proto.metadata_props if each.key == METADATA_KEY)
        metadata = msgspec.json.decode(entry.value, type=ModelMetadata)
    except Exception as error:  # onnx raises many types
        raise CheckpointError(f"{model}: not a model file of touchd") from error
    found = {t.name: torch.from_numpy(onnx.numpy_helper.to_array(t).copy()) for t in proto.graph.initializer}
    names = TrainSettings.__struct_fields__
    known = {name: value for name, value in metadata.training.items() if name in names}
    settings = msgspec.convert(known, TrainSettings)
    network = TGC(settings.network, len(metadata.labels))
    weights = network.state_dict()
    unnamed = [name for name in weights if f"calibrated.network.{name}" not in found]
    folded = [t for name, t in found.items() if not name.startswith("calibrated") and t.dim() >= 2]
    for name in unnamed:
        wanted = weights[name]
        for place, tensor in enumerate(folded):
            if (fitting := _unfolded(tensor, wanted, network)) is not None:
                weights[name] = fitting
                del folded[place]
                break
        else:
            raise CheckpointError(f"{model}: has no {name}")
    weights |= {name: found[f"calibrated.network.{name}"] for name in weights if name not in unnamed}
    return Checkpoint(
        settings, metadata.labels, settings.steps, weights, {}, metadata.code_version, metadata.data_sha256
    )


def _unfolded(tensor: Tensor, wanted: Tensor, network: TGC) -> Tensor | None:
    """Undo what the exporter did to a weight of the shape of `wanted`; None if the tensor is another's."""
    planes = network.stem.plane_weights
    if tensor.dim() == 4 and tensor.shape[:2] == (wanted.shape[0], planes.shape[1]) and wanted.dim() == 4:
        return torch.einsum("otyx,tp->opyx", tensor.double(), torch.linalg.pinv(planes.double())).float()
    if tensor.dim() == 3 and tensor.transpose(1, 2).shape == wanted.shape:
        return tensor.transpose(1, 2).contiguous()
    if tensor.dim() == 2 and tensor.T.shape == wanted.shape:
        return tensor.T.contiguous()
    return None


def load(path: Path) -> Checkpoint:
    """Read a checkpoint without running any code in it. Raises CheckpointError."""
    try:
        with zipfile.ZipFile(path) as archive:
            unpacked = sum(entry.file_size for entry in archive.infolist())
        if max(unpacked, path.stat().st_size) > MAX_FILE_BYTES:
            raise CheckpointError(
                f"{path}: larger than {MAX_FILE_BYTES >> 20} MiB; not a checkpoint of touchd"
            )
        stored = torch.load(path, map_location="cpu", weights_only=True)
        settings = msgspec.json.decode(stored["settings"], type=dict[str, Any])
        # A checkpoint of an older version may hold settings that no longer exist.
        known = {name: value for name, value in settings.items() if name in TrainSettings.__struct_fields__}
        # Older checkpoints count epochs, not steps.
        stored.setdefault("step", stored.get("epoch"))
        found = {field.name: stored[field.name] for field in fields(Checkpoint)}
        found |= {"settings": msgspec.convert(known, TrainSettings), "labels": tuple(stored["labels"])}
        return Checkpoint(**found)
    except CheckpointError:
        raise
    except FileNotFoundError as error:
        raise CheckpointError(f"{path}: there is no checkpoint; {ADVICE}") from error
    except Exception as error:  # torch raises many types for a damaged file, some with pages of advice
        raise CheckpointError(f"{path}: not a checkpoint of touchd; {ADVICE}") from error
