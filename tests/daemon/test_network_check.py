"""What the network sees of a touch, compared with the pad at rest, and when it is asked again."""

import numpy as np
import pytest
from numpy.typing import NDArray
from rigs.made_pad import MadePad, Scans, nothing, palm

from touchd.daemon.path.tracker.baseline import SECOND_FRAMES
from touchd.daemon.path.tracker.network_check import ASK_FRAMES, NetworkCheck


def times_asked(pressure: Scans, p_no_touch: float = 0.9) -> int:
    """Return how often the network is asked about these frames, after a second of rest."""
    frames = MadePad().counts(np.concatenate([nothing(1.0), pressure])).reshape(-1, 64).astype(np.float32)
    asked: list[NDArray[np.float32]] = []

    def ask(window: NDArray[np.float32]) -> float:
        asked.append(window)
        return p_no_touch

    check = NetworkCheck(ask)
    for stop in range(54, len(frames) + 1, ASK_FRAMES):
        check.begins_touch(frames[stop - SECOND_FRAMES : stop])
    return len(asked)


def test_a_pad_that_reads_as_before_is_not_asked_about_again() -> None:
    assert times_asked(nothing(10.0)) <= 3


@pytest.mark.parametrize(
    "pressure",
    [np.linspace(0, 10, 540)[:, None, None] * palm(10.0, 1.0, False), palm(10.0)],
    ids=["rising", "a hand"],
)
def test_a_pad_that_reads_otherwise_is_asked_about(pressure: Scans) -> None:
    assert times_asked(pressure) >= 8


def test_an_answer_that_saw_a_touch_is_asked_for_again() -> None:
    assert times_asked(nothing(10.0), p_no_touch=0.1) == 31


class Answers:
    """A network that gives these answers in turn, then repeats the last one."""

    def __init__(self, *answers: float) -> None:
        self.left = list(answers)

    def __call__(self, window: NDArray[np.float32]) -> float:
        assert window.shape[1:] == (8, 8)
        return self.left.pop(0) if len(self.left) > 1 else self.left[0]


def changing(number: int) -> NDArray[np.float32]:
    """Return frames that differ from the others by far."""
    return np.full((SECOND_FRAMES, 64), 10.0 * number, np.float32)


def check_with(*answers: float) -> NetworkCheck:
    return NetworkCheck(Answers(*answers))


def begins(check: NetworkCheck, times: int) -> list[bool]:
    """Ask about an untouched pad that changes each time."""
    return [check.begins_touch(changing(number)) for number in range(times)]


def rests_at(p_no_touch: float, *then: float) -> NetworkCheck:
    """Return a check that knows this answer at rest; the next answers are those given."""
    check = check_with(*[p_no_touch] * 9, *then)
    begins(check, 9)
    check.forget_answers()
    return check


def test_three_low_answers_in_a_row_begin_a_touch() -> None:
    assert begins(rests_at(0.9, 0.02), 4) == [False, False, True, True]
    assert begins(rests_at(0.9, 0.02, 0.9, 0.02), 5) == [False, False, False, False, True]


@pytest.mark.parametrize(("mean", "is_seen"), [(0.1, True), (0.16, False)])
def test_the_mean_of_three_answers_decides(mean: float, is_seen: bool) -> None:
    assert begins(rests_at(0.9, 0.0, 0.0, 3 * mean), 3)[-1] == is_seen


@pytest.mark.parametrize(
    ("rest", "answer", "is_seen"),
    [(0.9, 0.11, True), (0.22, 0.14, False), (0.22, 0.11, True), (0.18, 0.01, False), (0.0, 0.0, False)],
)
def test_a_pad_that_looks_touched_at_rest_needs_a_lower_answer(
    rest: float, answer: float, is_seen: bool
) -> None:
    assert begins(rests_at(rest, answer), 3)[-1] == is_seen
    assert rests_at(rest, answer).sees_touch(changing(0), 0.15) == is_seen


@pytest.mark.parametrize(("rest", "knows"), [(0.9, True), (0.21, True), (0.19, False)])
def test_the_network_knows_a_pad_by_its_answers_at_rest(rest: float, knows: bool) -> None:
    check = check_with(rest)
    assert (check.knows_rest, check.knows_pad) == (False, False)
    begins(check, 3)
    # A firm pad's first answers may be as high as those of a pad that the network knows.
    assert (check.knows_rest, check.knows_pad) == (knows, False)
    begins(check, 1)
    assert (check.knows_rest, check.knows_pad) == (knows, knows)
    check.forget_rest()
    assert (check.knows_rest, check.knows_pad) == (False, False)


def test_the_network_knows_no_pad_of_more_taxels_than_it_learned_from() -> None:
    finer = NetworkCheck(Answers(0.9), is_finer=True)
    begins(finer, 9)
    assert (finer.knows_rest, finer.knows_pad) == (True, False)


def asked_until(rest: float, then: float, knows: bool) -> int:
    """Return after how many answers at rest the network knows the pad, or no longer does."""
    check = rests_at(rest, then)
    for number in range(1, 100):
        check.begins_touch(changing(number))
        if check.knows_pad == knows:
            return number
    return 100


def test_what_is_known_of_rest_follows_within_seconds() -> None:
    assert 4 <= asked_until(0.1, 0.5, knows=True) <= 9
    assert 6 <= asked_until(0.3, 0.0, knows=False) <= 12


@pytest.mark.parametrize(
    ("answers", "is_over"),
    [
        ([0.9, 0.9], False),
        ([0.9, 0.9, 0.9], True),
        ([0.1, 0.9, 0.9, 0.9], True),
        ([0.9, 0.9, 0.1], False),
        ([0.9, 0.9, 0.21], True),
        ([0.48, 0.5, 0.5], False),
        ([0.5, 0.51, 0.5], True),
    ],
)
def test_three_answers_without_a_touch_end_one(answers: list[float], is_over: bool) -> None:
    check = rests_at(0.9, *answers)
    for number in range(len(answers)):
        check.follow_touch(changing(number))
    assert check.ends_touch == is_over
    check.forget_answers()
    assert not check.ends_touch


@pytest.mark.parametrize(("answer", "is_over"), [(0.19, True), (0.17, False)])
def test_a_touch_ends_on_a_pad_that_looks_touched_at_rest(answer: float, is_over: bool) -> None:
    check = rests_at(0.3, answer)
    for number in range(3):
        check.follow_touch(changing(number))
    assert check.ends_touch == is_over


def test_answers_are_forgotten_with_the_pad() -> None:
    check = rests_at(0.9, 0.02)
    assert begins(check, 2) == [False, False]
    check.forget_rest()
    assert begins(check, 3) == [False, False, False]


def test_without_a_network_light_contact_is_a_touch_and_rest_is_none() -> None:
    check = NetworkCheck(None)
    assert not check.is_there
    assert check.is_below(0.5, changing(0))
    assert not check.sees_touch(changing(0), 0.5)
    assert NetworkCheck(Answers(0.5)).is_there


@pytest.mark.parametrize(
    ("rise", "taxels", "is_asked"),
    [
        (0.19, 64, False),
        (0.22, 64, True),
        (1.9, 3, False),
        (2.1, 3, True),
        (-0.22, 64, True),
        (-1.9, 3, False),
    ],
)
def test_a_pad_is_asked_about_again_if_it_reads_differently(rise: float, taxels: int, is_asked: bool) -> None:
    network = Answers(0.9, 0.02, 0.9)
    check = NetworkCheck(network)
    still = np.full((SECOND_FRAMES, 64), 10.0, np.float32)
    check.begins_touch(still)
    read = still.copy()
    read[:, :taxels] += np.float32(rise)
    check.begins_touch(read)
    assert (network.left == [0.02, 0.9]) != is_asked


@pytest.mark.parametrize(("changed", "is_asked"), [(slice(0, 36), False), (slice(36, 54), True)])
def test_only_the_newest_third_of_a_second_counts_as_new(changed: slice, is_asked: bool) -> None:
    network = Answers(0.9, 0.02, 0.9)
    check = NetworkCheck(network)
    frames = np.full((SECOND_FRAMES, 64), 10.0, np.float32)
    check.begins_touch(frames)
    later = frames.copy()
    later[changed] += 5.0
    check.begins_touch(later)
    assert (network.left == [0.02, 0.9]) != is_asked
