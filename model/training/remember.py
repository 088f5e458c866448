"""Computes the statistics of training recordings that stand for other people during adaptation."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import torch

from touchd.drivers.whole_file import whole_file
from touchd.model.adapt.backbone import ARRAYS, CropFeatures, Remembered

DIRECTIONS = 16


def statistics(studies: Sequence[CropFeatures]) -> Remembered:
    """Return the statistics of each study's crops."""
    means, directions, rests, gestures = [], [], [], []
    for study in studies:
        for gesture in sorted(set(study.gestures)):
            own = study.of([i for i, each in enumerate(study.gestures) if each == gesture])
            values = own.values.flatten(0, 1).movedim(1, 0)  # (L, crops, features)
            mean = values.mean(dim=1, keepdim=True)
            spread = (values - mean) / values.shape[1] ** 0.5
            _, lengths, axes = torch.linalg.svd(spread, full_matrices=False)
            main = lengths[:, :DIRECTIONS, None] * axes[:, :DIRECTIONS]
            rest = spread.square().sum(dim=1) - main.square().sum(dim=1)
            means.append(mean.squeeze(1))
            directions.append(main)
            rests.append(rest.clamp_min(0.0).sqrt())
            gestures.append(gesture)
    return Remembered(torch.stack(means), torch.stack(directions), torch.stack(rests), tuple(gestures))


def save(remembered: Remembered, path: Path) -> None:
    """Write them to an .npz file, in half precision."""
    arrays = {name: getattr(remembered, name).numpy().astype(np.float16) for name in ARRAYS}
    with whole_file(path) as partial, partial.open("wb") as file:
        np.savez_compressed(file, gestures=np.array(remembered.gestures), **arrays)
