"""Statistics of the network's summaries of its training recordings, for rehearsal.

A head adapted to one person forgets others. Samples from these Gaussians stand for the others, whose
recordings are then not needed (generative feature replay, Liu et al. 2020).
"""

from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from touchd.model.adapt.backbone import CropFeatures

SAMPLES = 128
ARRAYS = ("means", "directions", "rests")


@dataclass(frozen=True, eq=False)
class Remembered:
    """A Gaussian for each study, gesture and length (N, L): its principal axes and each feature's residual.

    means, rests: (N, L, features); rests are residual standard deviations. directions: (N, L, R, features),
    each scaled by its standard deviation. gestures: (N,) names.
    """

    means: Tensor
    directions: Tensor
    rests: Tensor
    gestures: tuple[str, ...]

    def samples(self, gestures: Iterable[str], seed: int) -> CropFeatures:
        """Draw SAMPLES summaries from each study's Gaussian for each of these gestures."""
        rng = torch.Generator().manual_seed(seed)
        chosen = [i for wanted in gestures for i, own in enumerate(self.gestures) if own == wanted]
        N, L, R, F = self.directions[chosen].shape
        along = torch.randn(N, SAMPLES, L, R, generator=rng)
        values = torch.einsum("nslr,nlrf->nslf", along, self.directions[chosen])
        values = values + self.rests[chosen].unsqueeze(1) * torch.randn(N, SAMPLES, L, F, generator=rng)
        values = values + self.means[chosen].unsqueeze(1)
        names = tuple(self.gestures[i] for i in chosen)
        return CropFeatures(values, torch.ones(N, L, dtype=torch.bool), names)

    @classmethod
    def load(cls, path: Path) -> "Remembered":
        """Read them from an .npz file."""
        with np.load(path) as stored:
            means, directions, rests = (torch.from_numpy(stored[name].astype(np.float32)) for name in ARRAYS)
            return cls(means, directions, rests, tuple(stored["gestures"].tolist()))
