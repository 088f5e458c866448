"""Augmentation: varies pace, hand, place, pressure, pad, noise and framing of a touch.

Every function takes and returns a batch on one device. None waits for a result: on a GPU a training step is
recorded once and replayed.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import torch
from torch import Tensor
from torch.nn import functional

from touchd.drivers.frame import COLUMNS, FRAME_RATE_HZ, MAX_COUNT, ROWS
from touchd.model.settings import AugmentationSettings


@dataclass(frozen=True, eq=False)
class Frames:
    """Recordings' frames, one after the other: rows (F * 8, 8) float32, starts and lengths (R,) in frames."""

    rows: Tensor
    starts: Tensor
    lengths: Tensor

    @classmethod
    def of(cls, recordings: Sequence[Tensor], device: str = "cpu") -> "Frames":
        """Join recordings (T, 8, 8)."""
        lengths = torch.tensor([len(recording) for recording in recordings])
        rows = torch.cat([recording.reshape(-1, COLUMNS) for recording in recordings]).float()
        return cls(rows.to(device), (lengths.cumsum(0) - lengths).to(device), lengths.to(device))


def crop(
    frames: Frames, chosen: Tensor, length: int, settings: AugmentationSettings, rng: torch.Generator
) -> Tensor:
    """Return (B, length, 8, 8) float counts from random places in the recordings `chosen` (B,).

    Each at a random pace and framing. No recording may be shorter than a window; with a published framing, it
    must be a frame longer.
    """
    B, device = len(chosen), chosen.device
    # A published scan begins two rows early, so that it is cut short by as much.
    published = chosen_of(B, settings.published_framing, rng)[..., 0, 0].long()
    count = (frames.lengths[chosen][:, None] - published).float()
    pace = 1.0 + settings.pace * (2.0 * uniform_of(rng, B, 1) - 1.0)
    place = uniform_of(rng, B, 1)
    ticks = torch.arange(length, device=device)
    whole = torch.minimum((place * (count - length + 1)).floor(), count - length) + ticks
    paced = place * (count - 1 - (length - 1) * pace).clamp_min(0.0) + pace * ticks
    places = torch.where(chosen_of(B, settings.change_pace, rng)[..., 0, 0], paced, whole)
    # Where a recording is shorter than a window at its pace, its last frame is repeated.
    places = torch.minimum(places, count - 1)
    below = torch.minimum(places.floor(), count - 2)
    part = (places - below)[:, :, None, None]
    first = (frames.starts[chosen][:, None] + below.long()) * ROWS + published * (ROWS - 2)
    rows = first[:, :, None] + torch.arange(ROWS, device=device)
    return torch.lerp(frames.rows[rows], frames.rows[rows + ROWS], part)


def begin_from_rest(
    windows: Tensor, rest: Tensor, settings: AugmentationSettings, rng: torch.Generator
) -> Tensor:
    """Return windows (B, T, 8, 8), some of which rise from rest (B, T, 8, 8), as when a hand comes down."""
    B, T = windows.shape[:2]
    wait, rise = uniform_of(rng, 2, B, 1)
    rise_frames = 1.0 + rise * (settings.onset_frames - 1.0)
    ticks = torch.arange(T, device=windows.device)
    contact = ((ticks - wait * settings.onset_wait_frames) / rise_frames).clamp(0.0, 1.0)
    contact = torch.where(chosen_of(B, settings.onset, rng), contact[:, :, None, None], 1.0)
    return torch.lerp(rest, windows, contact)


def vary(counts: Tensor, settings: AugmentationSettings, rng: torch.Generator) -> Tensor:
    """Return (B, T, 8, 8) float counts with the hand's and the pad's properties varied per window."""
    B, T = counts.shape[:2]

    def normal(*shape: int) -> Tensor:
        return torch.randn(*shape, generator=rng, device=rng.device)

    def uniform() -> Tensor:
        return uniform_of(rng, B, 1, 1, 1)

    def chosen(probability: float) -> Tensor:
        return chosen_of(B, probability, rng).float()

    x = counts / MAX_COUNT
    x = x.clamp_min(1e-6) ** torch.exp(settings.gamma * normal(B, 1, 1, 1))
    x = x * torch.exp(settings.gain * normal(B, 1, 1, 1) + settings.taxel_gain * normal(B, 1, ROWS, COLUMNS))
    x = x * MAX_COUNT * torch.exp(settings.gain_field * _smooth(B, rng))
    x = _turn_and_shift(x, settings, rng)
    if settings.warp:
        x = _warp(x, settings.warp, rng)
    x = x + chosen(settings.rest) * _rest(B, settings.rest_counts, rng)
    x = x + chosen(settings.sway) * _sway(B, T, settings.sway_counts, rng)
    x = x + chosen(settings.hum) * _hum(B, T, settings.hum_counts, rng)
    x = x.clamp_min(0.0)
    rows = torch.arange(ROWS, device=x.device)[:, None]
    dead = rows == torch.randint(ROWS, (B, 1, 1, 1), generator=rng, device=rng.device)
    x = x * (1.0 - chosen(settings.dead_row) * dead)
    x = x + chosen(settings.offset) * settings.offset_counts * uniform()
    x = x + settings.noise_counts * uniform() * normal(*x.shape)
    lines = (normal(B, T, ROWS, 1), normal(B, T, 1, COLUMNS))
    line = torch.where(chosen_of(B, 0.5, rng), *lines)
    x = x + chosen(settings.line_noise) * settings.line_noise_counts * uniform() * line
    return x.clamp(0.0, MAX_COUNT)


def _turn_and_shift(x: Tensor, settings: AugmentationSettings, rng: torch.Generator) -> Tensor:
    """Turn and mirror some windows by one of the grid's eight symmetries, and move them by up to one taxel.

    Where a window is moved, its edge is repeated.
    """
    B, T = x.shape[:2]
    grid = torch.arange(ROWS * COLUMNS, device=x.device).reshape(ROWS, COLUMNS)
    quarters = [torch.rot90(grid, turn) for turn in range(4)]
    symmetries = torch.stack([*quarters, *(turned.flip(1) for turned in quarters)]).flatten(1)
    symmetry = torch.randint(len(symmetries), (B,), generator=rng, device=rng.device)
    turned = symmetries[symmetry * chosen_of(B, settings.turn, rng).flatten()]

    def moved(size: int) -> Tensor:
        step = torch.randint(-1, 2, (B, 1), generator=rng, device=rng.device)
        places = torch.arange(size, device=x.device) + step * chosen_of(B, settings.shift, rng)[..., 0, 0]
        return places.clamp(0, size - 1)

    place = moved(ROWS)[:, :, None] * COLUMNS + moved(COLUMNS)[:, None, :]
    source = turned.gather(1, place.flatten(1))
    return x.flatten(2).gather(2, source[:, None].expand(-1, T, -1)).reshape(x.shape)


def _warp(x: Tensor, spread: float, rng: torch.Generator) -> Tensor:
    """Displace what each taxel of (B, T, 8, 8) sees by a smooth field, repeating the edge."""
    theta = torch.eye(2, 3, device=x.device).expand(len(x), -1, -1)
    places = functional.affine_grid(theta, [len(x), 1, ROWS, COLUMNS], align_corners=True)
    moved = torch.stack([_smooth(len(x), rng), _smooth(len(x), rng)], dim=-1).squeeze(1)  # (B, 8, 8, 2)
    places = places + spread * moved * 2.0 / (ROWS - 1)
    warped: Tensor = functional.grid_sample(x, places, padding_mode="border", align_corners=True)
    return warped


def _rest(B: int, counts: float, rng: torch.Generator) -> Tensor:
    """Return offsets (B, 1, 8, 8) of up to `counts`: a smooth field, and some single taxels."""
    single = torch.randn(B, 1, ROWS, COLUMNS, generator=rng, device=rng.device)
    single = single * (uniform_of(rng, B, 1, ROWS, COLUMNS) < 0.2)
    depth = uniform_of(rng, B, 1, 1, 1) * counts
    offsets: Tensor = (depth * (_smooth(B, rng) + single)).clamp(-counts, counts)
    return offsets


def _sway(B: int, T: int, counts: float, rng: torch.Generator) -> Tensor:
    """Return (B, T, 8, 8) of slow movement: breathing and a drift of up to 1 count a second."""
    seconds = _seconds(T, rng)
    rate, phase, depth, drift = uniform_of(rng, 4, B, 1, 1, 1)
    breath = depth * counts * torch.sin(2.0 * math.pi * ((0.2 + 0.8 * rate) * seconds + phase))
    sway: Tensor = breath * _smooth(B, rng) + (2.0 * drift - 1.0) * seconds * _smooth(B, rng)
    return sway


def _hum(B: int, T: int, counts: float, rng: torch.Generator) -> Tensor:
    """Return (B, T, 1, 1) of a tone that all taxels share."""
    rate, phase, depth = uniform_of(rng, 3, B, 1, 1, 1)
    turns = (4.0 + 23.0 * rate) * _seconds(T, rng) + phase
    tone: Tensor = depth * counts * torch.sin(2.0 * math.pi * turns)
    return tone


def _seconds(T: int, rng: torch.Generator) -> Tensor:
    return (torch.arange(T, device=rng.device) / FRAME_RATE_HZ).reshape(1, T, 1, 1)


def _smooth(B: int, rng: torch.Generator) -> Tensor:
    """Return random fields (B, 1, 8, 8), about standard normal, that vary smoothly over the pad."""
    coarse = torch.randn(B, 1, 3, 3, generator=rng, device=rng.device)
    return functional.interpolate(coarse, (ROWS, COLUMNS), mode="bicubic", align_corners=True)


def uniform_of(rng: torch.Generator, *shape: int) -> Tensor:
    return torch.rand(*shape, generator=rng, device=rng.device)


def chosen_of(B: int, probability: float, rng: torch.Generator) -> Tensor:
    """Return (B, 1, 1, 1) bool, true with a probability."""
    return uniform_of(rng, B, 1, 1, 1) < probability
