"""The 54 Hz grid: what the model sees, whatever the pad's rate, jitter and losses."""

from collections.abc import Iterable
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray
from rigs.sensor_rig import stream_of

from touchd.drivers.frame import CLOCK_MODULUS, Counts, Frame
from touchd.drivers.pad.grid import PERIOD_MS, GridFrame, Ring
from touchd.drivers.recording import ideal_clock_ms, on_grid
from touchd.model.studies.simulated import simulate

SWING_COUNTS = 200.0
SWING_HZ = 3.5
# A linear interpolation between samples dt apart errs by at most (2 pi f dt)^2 / 8 of the amplitude.
SLOWEST_PERIOD_S = 1 / 50
INTERPOLATION_COUNTS = SWING_COUNTS * (2 * np.pi * SWING_HZ * SLOWEST_PERIOD_S) ** 2 / 8
ROUNDING_COUNTS = 1.0
# Error of a frame that is 1 ms off its time, at the steepest slope.
COUNTS_PER_MS = SWING_COUNTS * 2 * np.pi * SWING_HZ / 1000


def hand(at_ms: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the pressure that a hand patting at 3.5 Hz puts on the pad, (T, 8, 8)."""
    phase = np.arange(64).reshape(8, 8) * 0.3
    return 300 + SWING_COUNTS * np.sin(2 * np.pi * SWING_HZ * at_ms[:, None, None] / 1000 + phase)


def push(ring: Ring, counts: Counts, sensor_ms: Iterable[int]) -> list[GridFrame]:
    laid: list[GridFrame] = []
    for number, (scan, ms) in enumerate(zip(counts, sensor_ms, strict=True)):
        laid += ring.push(Frame(int(ms) % CLOCK_MODULUS, number / 54, scan))
    return laid


@pytest.mark.parametrize(
    ("rate_hz", "jitter_ms", "first_ms"),
    [(54.0, 0.0, 0), (53.5, 0.5, 1), (54.5, 0.5, 1), (54.0, 0.0, 2**32 - 1000)],
    ids=["54 Hz", "slower", "faster", "over the wrap of the clock"],
)
def test_a_pad_at_or_near_54_hz_passes_unchanged(rate_hz: float, jitter_ms: float, first_ms: int) -> None:
    ring, counts = Ring(600), stream_of(500).counts
    moved_ms = np.random.default_rng(2).uniform(-jitter_ms, jitter_ms, 500)
    sent_ms = np.rint(np.arange(500) * 1000 / rate_hz + moved_ms + first_ms).astype(int)
    laid = push(ring, counts, sent_ms)
    assert [frame.index for frame in laid] == list(range(500))
    # The ring returns each grid frame with the frame that completes it.
    assert [frame.host_s for frame in laid] == [number / 54 for number in range(500)]
    np.testing.assert_array_equal(ring.window(500, 500), counts)
    assert not any(frame.bridged for frame in laid)
    assert [frame.restarted for frame in laid] == [True] + [False] * 499
    np.testing.assert_allclose([frame.sensor_ms for frame in laid], sent_ms, atol=0.51 + jitter_ms)


@pytest.mark.parametrize("jitter_ms", [0.0, 4.0])
@pytest.mark.parametrize("rate_hz", [50, 54, 60, 80, 100])
def test_a_pad_at_a_different_rate_gives_ideal_windows(rate_hz: int, jitter_ms: float) -> None:
    seconds = 8
    rng = np.random.default_rng(3)
    true_ms = 10 + np.arange(seconds * rate_hz) * 1000 / rate_hz
    true_ms += rng.uniform(-jitter_ms, jitter_ms, len(true_ms))
    counts = np.rint(hand(true_ms)).astype(np.uint16)
    laid = push(Ring(600), counts, np.rint(true_ms).astype(int))

    assert abs(len(laid) - seconds * 54) <= 2
    grid_ms = np.array([frame.sensor_ms for frame in laid])
    off = np.abs(np.stack([frame.pressure for frame in laid]) - hand(grid_ms))
    # Jitter moves frames apart by up to twice its size; stamps are rounded to half a millisecond.
    wider = (1 + 2 * jitter_ms * rate_hz / 1000) ** 2
    assert off.max() < INTERPOLATION_COUNTS * wider + ROUNDING_COUNTS + 0.5 * COUNTS_PER_MS
    assert np.abs(np.diff(grid_ms) - PERIOD_MS).max() <= PERIOD_MS / 2 + 1
    drift_ms = grid_ms - np.arange(len(laid)) * PERIOD_MS
    assert np.ptp(drift_ms[2:]) <= PERIOD_MS
    assert not any(frame.bridged for frame in laid)


@pytest.mark.parametrize("lost", [[50], [50, 51, 52]])
def test_lost_frames_are_bridged_and_marked(lost: list[int]) -> None:
    counts, clock = stream_of(100).counts, ideal_clock_ms(100)
    kept = np.delete(np.arange(100), lost)
    ring = Ring(600)
    laid = push(ring, counts[kept], clock[kept])
    assert [frame.index for frame in laid] == list(range(100))
    assert [frame.index for frame in laid if frame.bridged] == lost
    first, stop = 49, lost[-1] + 1
    between = np.linspace(counts[first].astype(np.float32), counts[stop].astype(np.float32), len(lost) + 2)
    np.testing.assert_allclose(ring.window(stop + 1, len(lost) + 2), between, atol=20)
    np.testing.assert_array_equal(ring.window(100, 100 - stop), counts[stop:])


def test_a_reset_restarts_the_grid_but_not_its_indices() -> None:
    ring, counts = Ring(600), stream_of(4).counts
    laid = push(ring, counts[:2], [1000, 1019])
    ring.reset()
    laid += push(ring, counts[2:], [1037, 1056])
    assert [frame.index for frame in laid] == list(range(4))
    assert [frame.restarted for frame in laid] == [True, False, True, False]


@pytest.mark.parametrize("first_ms", [5000, CLOCK_MODULUS - 1500], ids=["", "over the wrap"])
@pytest.mark.parametrize(
    ("then_ms", "restarts_ms"),
    [
        ([2200], []),
        ([2201], [2201]),
        ([2000, 2019], []),
        ([1000, 1019], [1000]),
        ([1500, 1519, 1538], [1500]),
        ([1500, 2019], [1500, 2019]),
    ],
)
def test_only_gaps_and_clocks_that_ran_back_restart_the_grid(
    then_ms: list[int], restarts_ms: list[int], first_ms: int
) -> None:
    ring = Ring(600)
    clock_ms = [first_ms + ms for ms in [*range(1981, 2000, 19), 2000, *then_ms]]
    first, *laid = push(ring, stream_of(len(clock_ms)).counts, clock_ms)
    assert first.restarted
    assert [round(one.sensor_ms) for one in laid if one.restarted] == [
        (first_ms + ms) % CLOCK_MODULUS for ms in restarts_ms
    ]
    if restarts_ms and len(then_ms) > 1:
        assert abs(laid[-1].sensor_ms - (first_ms + then_ms[-1]) % CLOCK_MODULUS) < PERIOD_MS


def test_a_pad_that_reaches_54_hz_soon_passes_unchanged() -> None:
    ring, counts = Ring(600), stream_of(228).counts
    sent_ms = np.rint([*np.arange(120) * 1000 / 60, *(2000 + np.arange(108) * 1000 / 54)])
    laid = push(ring, counts, sent_ms.astype(int))
    np.testing.assert_array_equal(ring.window(laid[-1].index + 1, 54), counts[-54:])


def test_the_ring_refuses_frames_it_no_longer_has() -> None:
    ring, counts = Ring(50), stream_of(500).counts
    push(ring, counts, ideal_clock_ms(500))
    np.testing.assert_array_equal(ring.window(500, 50), counts[450:])
    with pytest.raises(ValueError, match="it has 450 to 500"):
        ring.window(500, 51)
    with pytest.raises(ValueError, match="it has 450 to 500"):
        ring.window(501, 10)


def test_a_random_clock_yields_a_bounded_number_of_frames() -> None:
    rng = np.random.default_rng(4)
    ring = Ring(50)
    zeros = np.zeros((8, 8), np.uint16)
    for _ in range(2000):
        laid = ring.push(Frame(int(rng.integers(0, CLOCK_MODULUS)), 0.0, zeros))
        assert len(laid) <= 1
    for ms in np.cumsum(rng.integers(0, 160, 2000)):
        assert len(ring.push(Frame(int(ms), 0.0, zeros))) <= 10


@pytest.mark.parametrize(("gap", "longest"), [(40, slice(40, None)), (120, slice(120))])
def test_a_recording_gives_its_longest_stretch_without_a_gap(gap: int, longest: slice) -> None:
    (recording,) = simulate([("pat", 3.0)], seed=1)
    clock_ms = recording.sensor_ms.copy()
    clock_ms[gap:] += 400
    laid = on_grid(replace(recording, sensor_ms=clock_ms))
    np.testing.assert_array_equal(laid.counts, recording.counts[longest])
    np.testing.assert_array_equal(laid.sensor_ms, ideal_clock_ms(len(laid.counts)))
