"""What the network remembers of the recordings that it learnt from: statistics of its own summaries.

A head that is adapted to one person forgets others. Samples from these Gaussians stand for the others, so
that no recording of theirs is needed (generative feature replay, Liu et al. 2020).
"""

from collections.abc import Collection, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from drivers.whole_file import whole_file
from model.adapt.backbone import CropFeatures

DIRECTIONS = 16
SAMPLES = 128
ARRAYS = ("means", "directions", "rests")


@dataclass(frozen=True, eq=False)
class Remembered:
    """A Gaussian for each study, gesture and length (N, L): what varies most, and each feature's rest.

    means, rests: (N, L, features). directions: (N, L, DIRECTIONS, features), each as long as its standard
    deviation. gestures: (N,) names.
    """

    means: Tensor
    directions: Tensor
    rests: Tensor
    gestures: tuple[str, ...]

    @classmethod
    def of(cls, studies: Sequence[CropFeatures]) -> "Remembered":
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
        return cls(torch.stack(means), torch.stack(directions), torch.stack(rests), tuple(gestures))

    def samples(self, gestures: Collection[str], seed: int) -> CropFeatures:
        """Return SAMPLES summaries of each study's Gaussian of these gestures."""
        rng = torch.Generator().manual_seed(seed)
        chosen = [i for i, gesture in enumerate(self.gestures) if gesture in gestures]
        N, L, R, F = self.directions[chosen].shape
        along = torch.randn(N, SAMPLES, L, R, generator=rng)
        values = torch.einsum("nslr,nlrf->nslf", along, self.directions[chosen])
        values = values + self.rests[chosen].unsqueeze(1) * torch.randn(N, SAMPLES, L, F, generator=rng)
        values = values + self.means[chosen].unsqueeze(1)
        names = tuple(self.gestures[i] for i in chosen)
        return CropFeatures(values, torch.ones(N, L, dtype=torch.bool), names)

    def save(self, path: Path) -> None:
        """Write them to an .npz file, in half precision."""
        arrays = {name: getattr(self, name).numpy().astype(np.float16) for name in ARRAYS}
        with whole_file(path) as partial, partial.open("wb") as file:
            np.savez_compressed(file, gestures=np.array(self.gestures), **arrays)

    @classmethod
    def load(cls, path: Path) -> "Remembered":
        """Read what `save` wrote."""
        with np.load(path) as stored:
            means, directions, rests = (torch.from_numpy(stored[name].astype(np.float32)) for name in ARRAYS)
            return cls(means, directions, rests, tuple(stored["gestures"].tolist()))
