"""Augmentations and disturbances stay within a pad's range and do what their names say."""

import msgspec
import numpy as np
import pytest

pytest.importorskip("torch", reason="needs the extra `train`")

import torch

from touchd.model.adapt.augment import Frames, crop, vary
from touchd.model.settings import AugmentationSettings
from touchd.model.studies.checks.disturb import DISTURBANCES
from touchd.model.studies.checks.hard_cases import checkerboard, hand
from touchd.model.training.other_pads import as_another_pad, as_quiet_pad
from touchd.model.training.settings import TrainAugmentation

OFF = TrainAugmentation(
    gain=0.0, gamma=0.0, taxel_gain=0.0, turn=0.0, shift=0.0, offset=0.0, noise_counts=0.0, dead_row=0.0
)
PRESSED = torch.full((32, 54, 8, 8), 100.0)


def varied(**settings: float) -> torch.Tensor:
    """Apply one kind of variation to an even pressure."""
    return vary(PRESSED, msgspec.structs.replace(OFF, **settings), torch.Generator().manual_seed(0))


def test_with_everything_off_counts_stay_as_they_are() -> None:
    torch.testing.assert_close(varied(), PRESSED)


def test_rest_hum_and_sway_each_move_the_pad_differently() -> None:
    rest = varied(rest=1.0, rest_counts=8.0) - PRESSED
    assert 6.0 < float(rest.abs().max()) <= 8.001
    assert float((rest - rest[:, :1]).abs().max()) < 1e-3
    hum = varied(hum=1.0, hum_counts=2.0) - PRESSED
    assert 1.5 < float(hum.abs().max()) <= 2.001
    assert float(hum.var(dim=(2, 3)).max()) < 1e-6
    sway = varied(sway=1.0, sway_counts=4.0) - PRESSED
    assert float(sway.abs().max()) > 2.0
    assert float(sway.diff(dim=1).abs().max()) < 2.0


@pytest.mark.parametrize("name", ["warp", "gain_field"])
def test_bending_keeps_the_pressure_and_its_timing(name: str) -> None:
    bent = varied(**{name: 0.5})
    assert float((bent - bent[:, :1]).abs().max()) < 1e-3
    if name == "warp":
        torch.testing.assert_close(bent, PRESSED)


@pytest.mark.parametrize("name", DISTURBANCES)
def test_a_disturbed_window_stays_in_range(name: str) -> None:
    windows = np.stack([hand(54), checkerboard(54)])
    disturbed = DISTURBANCES[name](windows)
    assert disturbed.shape == windows.shape
    assert disturbed.dtype == np.float32
    assert 0 <= disturbed.min() <= disturbed.max() <= 1023


def test_a_crop_may_have_a_different_pace() -> None:
    own = AugmentationSettings(published_framing=0.0, change_pace=1.0, pace=0.25)
    ramp = torch.arange(432.0)[:, None, None].expand(432, 8, 8)
    rng = torch.Generator().manual_seed(0)
    windows = crop(Frames.of([ramp, ramp]), torch.tensor([0, 1] * 25), 54, own, rng)
    assert 0.0 <= float(windows.min()) <= float(windows.max()) <= 431.0
    steps = windows[:, :, 0, 0].diff(dim=1)
    torch.testing.assert_close(steps, steps[:, :1].expand_as(steps), atol=1e-3, rtol=0.0)
    assert 0.75 <= float(steps.min()) < 0.8
    assert 1.2 < float(steps.max()) <= 1.251


def test_a_crop_at_normal_pace_is_part_of_its_recording() -> None:
    own = AugmentationSettings(published_framing=0.0, change_pace=0.0)
    one, other = torch.rand(60, 8, 8), torch.rand(54, 8, 8)
    chosen = torch.tensor([0, 1] * 10)
    rng = torch.Generator().manual_seed(0)
    for which, window in zip(chosen, crop(Frames.of([one, other]), chosen, 54, own, rng), strict=True):
        starts = range(7) if which == 0 else range(1)
        recording = one if which == 0 else other
        assert any(torch.equal(window, recording[start : start + 54]) for start in starts)


@pytest.mark.parametrize("frames", [54, 55, 60])
def test_a_crop_of_a_short_recording_stays_within_its_counts(frames: int) -> None:
    own = AugmentationSettings(published_framing=0.0, change_pace=1.0, pace=0.25)
    ramp = 100.0 + torch.arange(float(frames))[:, None, None].expand(-1, 8, 8)
    windows = crop(
        Frames.of([ramp]), torch.zeros(50, dtype=torch.long), 54, own, torch.Generator().manual_seed(0)
    )
    assert 100.0 <= float(windows.min()) <= float(windows.max()) <= 99.0 + frames
    assert float(windows.diff(dim=1).min()) >= -1e-4


def test_a_published_scan_begins_two_rows_early() -> None:
    own = AugmentationSettings(published_framing=1.0, change_pace=0.0)
    rows = torch.arange(55.0 * 8)[:, None].expand(-1, 8).reshape(55, 8, 8)
    (window,) = crop(Frames.of([rows]), torch.tensor([0]), 54, own, torch.Generator().manual_seed(0))
    torch.testing.assert_close(window.reshape(-1, 8)[:, 0], torch.arange(54.0 * 8) + 6.0)


def test_turned_and_moved_windows_hold_the_same_taxels() -> None:
    grid = torch.arange(64.0).reshape(1, 1, 8, 8).expand(400, 2, -1, -1)
    turned = vary(grid, msgspec.structs.replace(OFF, turn=1.0), torch.Generator().manual_seed(0))
    assert len({tuple(window[0].flatten().round().tolist()) for window in turned}) == 8
    assert all(sorted(window[0].flatten().round().tolist()) == list(range(64)) for window in turned)
    moved = vary(grid, msgspec.structs.replace(OFF, shift=1.0), torch.Generator().manual_seed(0)).round()
    assert {int(window[0, 3, 3]) for window in moved} == {r * 8 + c for r in (2, 3, 4) for c in (2, 3, 4)}


SOFT = msgspec.structs.replace(OFF, another_pad=1.0, rise_s=0.1, fall_s=1.0, coarse=0.0)
PATS = torch.where(torch.arange(108) % 27 < 8, 200.0, 0.0)[None, :, None, None].expand(16, -1, 8, 8)


def test_a_soft_pad_rises_faster_than_it_creeps_back() -> None:
    read = as_another_pad(PATS, SOFT, torch.Generator().manual_seed(0))
    assert float(read.min()) >= 0.0
    assert float(read.max()) <= 200.0
    assert float(read[:, 7].median()) > 150.0
    assert float(read[:, 26].max()) > 20.0


def test_a_coarse_pad_blurs_a_single_taxel() -> None:
    point = torch.zeros(16, 4, 8, 8)
    point[:, :, 3, 4] = 200.0
    coarse = msgspec.structs.replace(SOFT, rise_s=0.0, fall_s=0.0, coarse=1.0)
    read = as_another_pad(point, coarse, torch.Generator().manual_seed(0))
    assert float(read.amax(dim=(1, 2, 3)).max()) < 150.0


QUIET = msgspec.structs.replace(OFF, quiet=1.0, quiet_counts=8.0, quiet_frames=8)


def test_a_quiet_pad_reads_less_noise_and_the_same_touch() -> None:
    rng = torch.Generator().manual_seed(0)
    noisy = PATS + torch.randn(PATS.shape, generator=rng).abs()
    read = as_quiet_pad(noisy, QUIET, rng)
    resting = torch.arange(108) % 27 > 18
    spread, before = (each[:, resting].flatten(1).std(dim=1).median() for each in (read, noisy))
    assert float(spread) < 0.5 * float(before)
    assert float(read.min()) >= 0.0
    assert float((read[:, 7] - PATS[:, 7]).abs().max()) < 10.0
    assert as_quiet_pad(noisy, OFF, rng) is noisy
