"""Touches in passing: where a hand touches and leaves within a recording, and the windows made of it."""

from collections.abc import Sequence

import numpy as np
import pytest

pytest.importorskip("torch", reason="needs the extra `train`")

import torch

from touchd.drivers.recording import Recording, ideal_clock_ms
from touchd.model.adapt.augment import Frames
from touchd.model.training.contacts import contacts, rests_of, shift_of_rest
from touchd.model.training.passing import Passing

PAD_REST = 3


def recording(
    gesture: str, touched: Sequence[tuple[int, int]], person: str = "P3", frames: int = 400
) -> Recording:
    """Return a made-up recording that is touched during some spans of frames."""
    counts = np.full((frames, 8, 8), PAD_REST, np.uint16)
    for first, stop in touched:
        counts[first:stop, 2:5, 2:5] += 200
    return Recording(person, "foam", "fur", gesture, counts, ideal_clock_ms(frames), "live")


PATS = [(0, 10), (30, 38), (60, 68), (90, 98), (390, 400)]


def test_the_complete_contacts_of_a_pat_are_found() -> None:
    found = contacts(recording("pat", PATS), is_soft=False)
    assert [(abs(a - c) <= 1, abs(b - d) <= 1) for (a, b), (c, d) in zip(found, PATS[1:4], strict=True)] == [
        (True, True)
    ] * 3


def test_a_slip_between_strokes_is_not_a_stroke() -> None:
    found = contacts(recording("stroke", [(50, 80), (100, 106), (130, 170)]), is_soft=False)
    assert [round((stop - first) / 10) for first, stop in found] == [3, 4]


def test_a_contact_ends_on_a_pad_that_creeps_back() -> None:
    soft = recording("pat", [], frames=250)
    counts = soft.counts.astype(np.float32)
    for first in (50, 120, 190):
        counts[first : first + 10, 2:5, 2:5] += 200
        counts[first + 10 : first + 60, 2:5, 2:5] += 50 * np.exp(-np.arange(50) / 30)[:, None, None]
    creeping = Recording("S03", "flat", "none", "pat", counts.astype(np.uint16), soft.sensor_ms, "live")
    assert [stop - first < 20 for first, stop in contacts(creeping, is_soft=True)] == [True] * 3


def test_rest_is_of_the_same_set_up_where_possible() -> None:
    own, other = recording("notouch", []), recording("notouch", [])
    elsewhere = Recording("P3", "none", "none", "pat", own.counts, own.sensor_ms, "live")
    assert rests_of([other, recording("pat", PATS), elsewhere, recording("rub", [], "P9")]) == [
        [0],
        [0],
        [0],
        [],
    ]


def test_the_rest_shifts_by_at_most_eight_counts() -> None:
    touched = np.full((60, 8, 8), PAD_REST + 5.0)
    touched[:, 0, 0] += 30
    shift = shift_of_rest(touched, np.full((60, 8, 8), PAD_REST))
    assert (shift[1, 1], shift[0, 0]) == (5, 8)


def setup_of(touched: Recording) -> tuple[Frames, Passing, torch.Generator]:
    """Return what windows are made of: a recording at rest, and a touched one."""
    recordings = [recording("notouch", []), touched]
    frames = Frames.of([torch.from_numpy(each.counts.astype(np.float32)) for each in recordings])
    return frames, Passing.of(recordings, [False, False], "cpu"), torch.Generator().manual_seed(0)


@pytest.mark.parametrize("gesture", ["pat", "stroke", "rub"])
def test_a_window_of_a_touch_in_passing_ends_in_rest(gesture: str) -> None:
    spans = {"pat": PATS, "stroke": [(50, 80), (100, 135)], "rub": [(0, 400)]}[gesture]
    frames, passing, rng = setup_of(recording(gesture, spans))
    windows, over = passing._windows(frames, torch.ones(64, dtype=torch.long), 144, rng)
    for window, end in zip(windows, over.tolist(), strict=True):
        level = window.sum(dim=(1, 2)) - 64 * PAD_REST
        assert level[:end].max() > 500
        assert level[end + 6 :].abs().max() < 1e-3


def test_rest_is_never_made_a_touch_in_passing() -> None:
    frames, passing, rng = setup_of(recording("rub", [(0, 400)]))
    before = torch.rand(8, 144, 8, 8)
    lengths = torch.tensor([54, 144]).expand(8, -1)
    rest = torch.zeros(8, dtype=torch.long)
    windows, asked, weights = passing.some(frames, rest, before, lengths, 1.0, rng)
    assert torch.equal(windows, before)
    assert asked.shape == (8, 3)
    assert torch.equal(weights, torch.ones(8, 3))


def test_answers_long_after_the_hand_left_have_no_weight() -> None:
    frames, passing, rng = setup_of(recording("pat", PATS))
    chosen = torch.ones(32, dtype=torch.long)
    lengths = torch.tensor([9, 144]).expand(32, -1)
    _, asked, weights = passing.some(frames, chosen, torch.zeros(32, 144, 8, 8), lengths, 1.0, rng)
    is_short = asked[:, 2] < 60
    assert is_short.any()
    assert (weights[is_short, 1] == 0).all()
    assert (weights[:, 2] > 0).all()
