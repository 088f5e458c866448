"""Simulates how other kinds of pads would read a touch: softer and coarser ones, and ones without noise."""

import torch
from torch import Tensor
from torch.nn import functional

from touchd.drivers.frame import COLUMNS, FRAME_RATE_HZ, ROWS
from touchd.model.adapt.augment import chosen_of, uniform_of
from touchd.model.training.settings import TrainAugmentation

COARSE_SIDES = range(4, ROWS)


def as_another_pad(counts: Tensor, settings: TrainAugmentation, rng: torch.Generator) -> Tensor:
    """Return (B, T, 8, 8) counts, some windows as a softer, coarser pad would have read them."""
    if not settings.another_pad:
        return counts
    B, T = counts.shape[:2]
    followed = _creep(counts, settings, rng)
    fewer = _coarse(counts.device)[torch.randint(len(COARSE_SIDES), (B,), generator=rng, device=rng.device)]
    blurred = (followed.reshape(B, T, -1) @ fewer).reshape(counts.shape)
    read = torch.where(chosen_of(B, settings.coarse, rng), blurred, followed)
    return torch.where(chosen_of(B, settings.another_pad, rng), read, counts)


def _coarse(device: torch.device) -> Tensor:
    """Return (sides, 64, 64): how a pad with fewer taxels, interpolated to 8x8, reads each taxel."""
    taxels = torch.eye(ROWS * COLUMNS, device=device).reshape(-1, 1, ROWS, COLUMNS)
    pads = [
        functional.interpolate(functional.adaptive_avg_pool2d(taxels, side), (ROWS, COLUMNS), mode="bilinear")
        for side in COARSE_SIDES
    ]
    return torch.stack(pads).reshape(len(COARSE_SIDES), ROWS * COLUMNS, ROWS * COLUMNS)


def _creep(x: Tensor, settings: TrainAugmentation, rng: torch.Generator) -> Tensor:
    """Return (B, T, 8, 8) after a one-pole low-pass filter, with time constants for rise and fall."""
    rise_s, fall_s = uniform_of(rng, 2, len(x), 1, 1) ** 2
    rise = 1.0 - torch.exp(-1.0 / (FRAME_RATE_HZ * settings.rise_s * rise_s + 1e-3))
    fall = 1.0 - torch.exp(-1.0 / (FRAME_RATE_HZ * settings.fall_s * fall_s + 1e-3))
    followed = [x[:, 0]]
    for frame in x.unbind(1)[1:]:
        change = frame - followed[-1]
        followed.append(followed[-1] + torch.where(change > 0, rise, fall) * change)
    return torch.stack(followed, dim=1)


def as_quiet_pad(counts: Tensor, settings: TrainAugmentation, rng: torch.Generator) -> Tensor:
    """Return (B, T, 8, 8) counts, some windows as a pad without noise would have read them."""
    if not settings.quiet:
        return counts
    B = len(counts)
    spans = torch.randint(1, settings.quiet_frames + 1, (B,), generator=rng, device=rng.device)
    x = _mean_of_last(counts, spans, settings.quiet_frames)
    x = x - settings.quiet_counts * uniform_of(rng, B, 1, 1, 1)
    x = torch.where(chosen_of(B, 0.5, rng), x.round(), x).clamp_min(0.0)
    return torch.where(chosen_of(B, settings.quiet, rng), x, counts)


def _mean_of_last(x: Tensor, spans: Tensor, longest: int) -> Tensor:
    """Return the means of each of (B, T, 8, 8) and the frames before it, of `spans` (B,) frames.

    The first frame stands for those before it.
    """
    B, T = x.shape[:2]
    earlier = x[:, :1].expand(-1, longest - 1, -1, -1)
    sums = torch.cat([torch.zeros_like(x[:, :1]), earlier, x], dim=1).cumsum(1)
    windows = torch.arange(B, device=x.device)[:, None]
    ends = torch.arange(longest, longest + T, device=x.device)
    before = ends - spans[:, None]
    means: Tensor = (sums[:, longest:] - sums[windows, before]) / spans[:, None, None, None]
    return means
