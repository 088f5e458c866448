"""Checkpoints: a network with its origin and the state that resuming needs."""

import zipfile
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

import msgspec
import torch
from torch import Tensor

from touchd.drivers.errors import TouchdError
from touchd.drivers.whole_file import whole_file
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

    network: the averaged weights, the ones to use.
    training: raw weights, optimizer and random states, to resume; empty in a file to use.
    """

    settings: TrainSettings
    labels: tuple[str, ...]
    step: int
    network: dict[str, Tensor]
    training: dict[str, Any]
    code_version: str
    data_sha256: str

    def build(self) -> TGC:
        """Return the averaged network, ready to answer."""
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


def load(path: Path) -> Checkpoint:
    """Read a checkpoint; no code in it is ever run. Raises CheckpointError."""
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
