"""Augmentation: varies pace, hand, place, pressure, pad, noise and framing of a touch."""

import math

import torch
from torch import Tensor
from torch.nn import functional

from touchd.drivers.frame import COLUMNS, FRAME_RATE_HZ, MAX_COUNT, ROWS
from touchd.model.settings import AugmentationSettings


def crop(recording: Tensor, length: int, settings: AugmentationSettings, rng: torch.Generator) -> Tensor:
    """Return (length, 8, 8) float counts from a random place in (T, 8, 8), at a random pace and framing."""
    frames = recording
    if _chance(settings.published_framing, rng):
        rows = recording.reshape(-1, COLUMNS)[ROWS - 2 : -2]
        frames = rows.reshape(-1, ROWS, COLUMNS)
    if not _chance(settings.change_pace, rng):
        first = int(torch.randint(len(frames) - length + 1, (1,), generator=rng))
        return frames[first : first + length].float()
    pace = 1.0 + settings.pace * (2.0 * torch.rand(1, generator=rng).item() - 1.0)
    slack = max(0.0, len(frames) - 1 - (length - 1) * pace)
    places = slack * torch.rand(1, generator=rng) + pace * torch.arange(length)
    below = places.long().clamp_max(len(frames) - 2)
    part = (places - below)[:, None, None]
    return frames[below].float() * (1.0 - part) + frames[below + 1].float() * part


def begin_from_rest(
    window: Tensor, rest: Tensor, settings: AugmentationSettings, rng: torch.Generator
) -> Tensor:
    """Return a window (T, 8, 8) that rises from rest (T, 8, 8), as a touch does when a hand comes down."""
    if not _chance(settings.onset, rng):
        return window
    wait, rise = torch.rand(2, generator=rng).tolist()
    rise_frames = 1.0 + rise * (settings.onset_frames - 1.0)
    contact = ((torch.arange(len(window)) - wait * settings.onset_wait_frames) / rise_frames).clamp(0.0, 1.0)
    return torch.lerp(rest, window, contact[:, None, None])


def as_another_pad(counts: Tensor, settings: AugmentationSettings, rng: torch.Generator) -> Tensor:
    """Return (B, T, 8, 8) counts, some windows as a softer, coarser pad would have read them."""
    these = torch.rand(len(counts), generator=rng) < settings.another_pad
    if not these.any():
        return counts
    x = _creep(counts[these], settings, rng)
    for i in (torch.rand(len(x), generator=rng) < settings.coarse).nonzero().flatten().tolist():
        side = int(torch.randint(4, ROWS, (1,), generator=rng))
        fewer = functional.adaptive_avg_pool2d(x[i], side)
        x[i] = functional.interpolate(fewer[:, None], (ROWS, COLUMNS), mode="bilinear")[:, 0]
    changed = counts.clone()
    changed[these] = x
    return changed


def _creep(x: Tensor, settings: AugmentationSettings, rng: torch.Generator) -> Tensor:
    """Return (B, T, 8, 8) followed by one pole, whose time constant differs for rise and fall."""
    rise_s, fall_s = torch.rand(2, len(x), 1, 1, generator=rng) ** 2
    rise = 1.0 - torch.exp(-1.0 / (FRAME_RATE_HZ * settings.rise_s * rise_s + 1e-3))
    fall = 1.0 - torch.exp(-1.0 / (FRAME_RATE_HZ * settings.fall_s * fall_s + 1e-3))
    followed = [x[:, 0]]
    for frame in x.unbind(1)[1:]:
        change = frame - followed[-1]
        followed.append(followed[-1] + torch.where(change > 0, rise, fall) * change)
    return torch.stack(followed, dim=1)


def as_quiet_pad(counts: Tensor, settings: AugmentationSettings, rng: torch.Generator) -> Tensor:
    """Return (B, T, 8, 8) counts, some windows as a pad without noise would have read them."""
    if not settings.quiet:
        return counts
    quiet = counts.clone()
    for i in (torch.rand(len(counts), generator=rng) < settings.quiet).nonzero().flatten().tolist():
        noise, rounds = torch.rand(2, generator=rng).tolist()
        frames = int(torch.randint(settings.quiet_frames, (1,), generator=rng)) + 1
        x = _mean_of_last(counts[i], frames) - noise * settings.quiet_counts
        quiet[i] = (x.round() if rounds < 0.5 else x).clamp_min(0.0)
    return quiet


def _mean_of_last(x: Tensor, frames: int) -> Tensor:
    """Return the mean of each of (T, 8, 8) and the frames before it; the first stands for those before."""
    longer = torch.cat([x[:1].expand(frames - 1, -1, -1), x])
    return longer.unfold(0, frames, 1).mean(dim=-1)


def vary(counts: Tensor, settings: AugmentationSettings, rng: torch.Generator) -> Tensor:
    """Return (B, T, 8, 8) float counts with the hand's and the pad's properties varied per window."""
    B = len(counts)

    def normal(*shape: int) -> Tensor:
        return torch.randn(*shape, generator=rng)

    def chosen(probability: float) -> Tensor:
        return (torch.rand(B, 1, 1, 1, generator=rng) < probability).float()

    x = counts / MAX_COUNT
    x = x.clamp_min(1e-6) ** torch.exp(settings.gamma * normal(B, 1, 1, 1))
    x = x * torch.exp(settings.gain * normal(B, 1, 1, 1) + settings.taxel_gain * normal(B, 1, ROWS, COLUMNS))
    x = x * MAX_COUNT * torch.exp(settings.gain_field * _smooth(B, rng))
    x = _shift(_turn(x, settings.turn, rng), settings.shift, rng)
    if settings.warp:
        x = _warp(x, settings.warp, rng)
    x = x + chosen(settings.rest) * _rest(B, settings.rest_counts, rng)
    x = x + chosen(settings.sway) * _sway(B, x.shape[1], settings.sway_counts, rng)
    x = x + chosen(settings.hum) * _hum(B, x.shape[1], settings.hum_counts, rng)
    x = x.clamp_min(0.0)
    dead = torch.rand(B, 1, ROWS, 1, generator=rng).argsort(dim=2) == 0
    x = x * (1.0 - chosen(settings.dead_row) * dead)
    x = x + chosen(settings.offset) * settings.offset_counts * torch.rand(B, 1, 1, 1, generator=rng)
    x = x + settings.noise_counts * torch.rand(B, 1, 1, 1, generator=rng) * normal(*x.shape)
    lines = (normal(B, x.shape[1], ROWS, 1), normal(B, x.shape[1], 1, COLUMNS))
    line = torch.where(torch.rand(B, 1, 1, 1, generator=rng) < 0.5, *lines)
    depth = settings.line_noise_counts * torch.rand(B, 1, 1, 1, generator=rng)
    x = x + chosen(settings.line_noise) * depth * line
    return x.clamp(0.0, MAX_COUNT)


def _turn(x: Tensor, probability: float, rng: torch.Generator) -> Tensor:
    """Turn and mirror some windows by one of the grid's eight symmetries."""
    symmetry = torch.randint(8, (len(x),), generator=rng)
    symmetry = symmetry * (torch.rand(len(x), generator=rng) < probability)
    turned = x.clone()
    for s in range(1, 8):
        these = symmetry == s
        rotated = torch.rot90(x[these], s % 4, dims=(2, 3))
        turned[these] = rotated.flip(3) if s >= 4 else rotated
    return turned


def _shift(x: Tensor, probability: float, rng: torch.Generator) -> Tensor:
    """Move each window by up to one taxel along each axis, repeating the edge."""
    B = len(x)
    for axis, size in ((2, ROWS), (3, COLUMNS)):
        step = torch.randint(-1, 2, (B,), generator=rng)
        step = step * (torch.rand(B, generator=rng) < probability)
        moved = x.clone()
        for direction in (-1, 1):
            source = (torch.arange(size) + direction).clamp(0, size - 1)
            moved[step == direction] = x[step == direction].index_select(axis, source)
        x = moved
    return x


def _warp(x: Tensor, spread: float, rng: torch.Generator) -> Tensor:
    """Displace what each taxel of (B, T, 8, 8) sees by a smooth field, repeating the edge."""
    theta = torch.eye(2, 3).expand(len(x), -1, -1)
    places = functional.affine_grid(theta, [len(x), 1, ROWS, COLUMNS], align_corners=True)
    moved = torch.stack([_smooth(len(x), rng), _smooth(len(x), rng)], dim=-1).squeeze(1)  # (B, 8, 8, 2)
    places = places + spread * moved * 2.0 / (ROWS - 1)
    warped: Tensor = functional.grid_sample(x, places, padding_mode="border", align_corners=True)
    return warped


def _rest(B: int, counts: float, rng: torch.Generator) -> Tensor:
    """Return offsets (B, 1, 8, 8) of up to `counts`: a smooth field, and some single taxels."""
    single = torch.randn(B, 1, ROWS, COLUMNS, generator=rng)
    single = single * (torch.rand(B, 1, ROWS, COLUMNS, generator=rng) < 0.2)
    depth = torch.rand(B, 1, 1, 1, generator=rng) * counts
    offsets: Tensor = (depth * (_smooth(B, rng) + single)).clamp(-counts, counts)
    return offsets


def _sway(B: int, T: int, counts: float, rng: torch.Generator) -> Tensor:
    """Return (B, T, 8, 8) of slow movement: breathing and a drift of up to 1 count a second."""
    seconds = (torch.arange(T) / FRAME_RATE_HZ).reshape(1, T, 1, 1)
    rate, phase, depth, drift = torch.rand(4, B, 1, 1, 1, generator=rng)
    breath = depth * counts * torch.sin(2.0 * math.pi * ((0.2 + 0.8 * rate) * seconds + phase))
    sway: Tensor = breath * _smooth(B, rng) + (2.0 * drift - 1.0) * seconds * _smooth(B, rng)
    return sway


def _hum(B: int, T: int, counts: float, rng: torch.Generator) -> Tensor:
    """Return (B, T, 1, 1) of a tone that all taxels share."""
    seconds = (torch.arange(T) / FRAME_RATE_HZ).reshape(1, T, 1, 1)
    rate, phase, depth = torch.rand(3, B, 1, 1, 1, generator=rng)
    tone: Tensor = depth * counts * torch.sin(2.0 * math.pi * ((4.0 + 23.0 * rate) * seconds + phase))
    return tone


def _smooth(B: int, rng: torch.Generator) -> Tensor:
    """Return random fields (B, 1, 8, 8), about standard normal, that vary smoothly over the pad."""
    coarse = torch.randn(B, 1, 3, 3, generator=rng)
    return functional.interpolate(coarse, (ROWS, COLUMNS), mode="bicubic", align_corners=True)


def _chance(probability: float, rng: torch.Generator) -> bool:
    return bool(torch.rand(1, generator=rng).item() < probability)
