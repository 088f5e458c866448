"""The detector's inputs, and how rest and noise follow the pad; training and export share this code."""

from typing import NamedTuple

import torch
from torch import Tensor

from touchd.drivers.frame import FRAME_RATE_HZ
from touchd.model.detector import LEAST_NOISE_COUNTS, STEP_DEVIATIONS

# Rest follows an untouched pad with this time constant, noise with a longer one.
REST_S, NOISE_S = 2.0, 5.0
# If counts fall below rest by this many deviations, rest was measured under a hand, and follows fast.
SUNKEN_DEVIATIONS, SUNKEN_S = 8.0, 0.25
# Time constant of a taxel's recent level, which becomes that of a load that keeps still.
LATELY_S = 0.7
# Half of the pad's highest load is forgotten in 13 s.
PEAK_KEPT = 0.999
CHANNELS, TOTALS = 4, 2


class Pad(NamedTuple):
    """What is known of the pad before a frame.

    levels: (..., 3, 64) counts: rest, the frame before, the recent level. noise: (..., 1, 64), the deviation
    at rest in counts. peak: (..., 1), the highest recent load.
    """

    levels: Tensor
    noise: Tensor
    peak: Tensor


def inputs(counts: Tensor, pad: Pad) -> tuple[Tensor, Tensor]:
    """Return the network's inputs for (..., 1, 64) counts: (..., 4, 64) by taxel, (..., 2) of the whole pad.

    They are logarithmic, and mostly in units of the taxel's noise, so that a pad's gain does not matter.
    """
    moved = counts - pad.levels
    taxels = torch.cat([moved / pad.noise, moved[..., :1, :]], dim=-2)
    load = _load(moved, pad.noise)
    totals = torch.cat([load + 1.0, (load + 8.0) / (torch.maximum(pad.peak, load) + 8.0)], dim=-1)
    return taxels.asinh(), totals.log()


def follow(counts: Tensor, pad: Pad, untouched: Tensor) -> Pad:
    """Return what is known of the pad after a frame of (..., 1, 64) counts.

    untouched: (..., 1, 1), 0 during a touch, else the probability that no hand is on the pad.
    """
    moved = counts - pad.levels
    above, step = moved[..., :1, :], moved[..., 1:2, :].abs() / STEP_DEVIATIONS
    is_sunken = above < -SUNKEN_DEVIATIONS * pad.noise
    rest_share = untouched * torch.where(is_sunken, _share(SUNKEN_S), _share(REST_S))
    shares = torch.cat([rest_share, torch.ones_like(above), torch.full_like(above, _share(LATELY_S))], dim=-2)
    noise = pad.noise + untouched * _share(NOISE_S) * (step - pad.noise)
    return Pad(
        pad.levels + shares * moved,
        noise.clamp_min(LEAST_NOISE_COUNTS),
        torch.maximum(pad.peak * PEAK_KEPT, _load(moved, pad.noise)),
    )


def begin(frames: Tensor) -> Pad:
    """Return what is known of an untouched pad from its first (..., T, 64) counts."""
    rest = frames.median(dim=-2, keepdim=True).values
    noise = frames.diff(dim=-2).abs().mean(dim=-2, keepdim=True) / STEP_DEVIATIONS
    levels = torch.cat([rest, frames[..., -1:, :], rest], dim=-2)
    return Pad(levels, noise.clamp_min(LEAST_NOISE_COUNTS), torch.zeros_like(rest[..., 0, :1]))


def _load(moved: Tensor, noise: Tensor) -> Tensor:
    """Return (..., 1), the counts above rest and noise, summed over the pad."""
    return (moved[..., 0, :] - 2.0 * noise[..., 0, :]).clamp_min(0.0).sum(dim=-1, keepdim=True)


def _share(seconds: float) -> float:
    """Return the share of a difference that a level with this time constant takes over in each frame."""
    return 1.0 / (seconds * FRAME_RATE_HZ)
