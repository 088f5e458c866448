"""Stopping rules, compared on made-up streams of probabilities, and their pages."""

import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from rigs.stored_report import DOCS

from touchd.model.studies.decision.early import best_choice, choices_of, compare, score, write
from touchd.model.studies.decision.streams import FRAMES, Streams

LABELS = ("notouch", "pat", "rub", "stroke")


def streams_sure_from(frames: list[int], sure: float, always_right: bool = True) -> Streams:
    """Touches of four people; their gesture leads from the first frame and is sure from these frames on."""
    rng = np.random.default_rng(1)
    truth = rng.integers(1, len(LABELS), len(frames))
    predicted = np.full((len(frames), FRAMES, len(LABELS)), 0.15)
    for row, (place, begin) in enumerate(zip(truth, frames, strict=True)):
        wrong = 1 + place % (len(LABELS) - 1)
        predicted[row, :, place] = 0.4
        predicted[row, begin - 1 :, place] = sure / (1 - sure) * 0.45
        if not always_right:
            predicted[row, : begin - 1, wrong] = 0.6
    predicted += rng.uniform(0, 0.001, predicted.shape)
    predicted /= predicted.sum(axis=2, keepdims=True)
    people = np.array([f"P{row % 4}" for row in range(len(frames))])
    return Streams(predicted.astype(np.float32), truth, np.full(len(frames), 3), people, LABELS)


@pytest.fixture(scope="module")
def late() -> Streams:
    """Wrong up to frame 30 or so, right and sure from then on."""
    return streams_sure_from([28 + row % 5 for row in range(40)], 0.9, always_right=False)


def test_the_oracle_stops_where_the_answer_becomes_right(late: Streams) -> None:
    (oracle,) = [entry for entry in compare(late) if entry.rule == "oracle"]
    assert (oracle.error, oracle.harmed) == (0.0, 0.0)
    assert oracle.mean_s == pytest.approx(30 / 54)


def test_patience_waits_as_many_frames_and_no_longer(late: Streams) -> None:
    at = {entry.rule: entry for entry in compare(late) if entry.setting == "0.80"}
    assert at["confidence"].mean_s == pytest.approx(30 / 54)
    assert at["confidence for 5 frames"].mean_s == pytest.approx(34 / 54)


def test_no_rule_is_better_than_the_oracle(late: Streams) -> None:
    scores = compare(late)
    oracle = min(entry.costs for entry in scores if entry.rule == "oracle")
    names = "fixed time, confidence, confidence for 5 frames, falling confidence, margin, sequential test, "
    assert {entry.rule for entry in scores} == {*f"{names}learnt trigger, two tiers, oracle".split(", ")}
    assert all(entry.costs >= oracle for entry in scores)


def other_gesture(streams: Streams, frames: slice) -> Streams:
    """Return the same touches with another gesture predicted in these frames."""
    predicted = streams.probabilities.copy()
    predicted[:, frames, 1:] = np.roll(predicted[:, frames, 1:], 1, axis=2)
    return replace(streams, probabilities=predicted)


def test_a_right_answer_that_a_mark_undoes_is_harmful() -> None:
    streams = streams_sure_from([9] * 8, 0.9)
    undone = other_gesture(streams, slice(53, None))
    assert score("fixed", "9", undone, np.full(8, 9)).harmed == 1
    assert score("fixed", "9", streams, np.full(8, 9)).harmed == 0


def test_early_answers_become_the_default_only_where_right() -> None:
    right = choices_of(streams_sure_from([10 + row % 5 for row in range(40)], 0.95))
    wrong = choices_of(other_gesture(streams_sure_from([9] * 8, 0.95), slice(50)))
    assert best_choice({"one": right}) == "when_sure, eager"
    assert best_choice({"one": right, "other": wrong}) == "at_mark"


def test_pages_and_figure_are_filled_from_the_streams(late: Streams, tmp_path: Path) -> None:
    for page in ("early.md", "decision.md"):
        shutil.copy(DOCS / page, tmp_path)
    write({"made up": late}, late, tmp_path)
    early, decision = ((tmp_path / page).read_text() for page in ("early.md", "decision.md"))
    assert "| made up | 4 | 40 |" in early
    assert "| made up | `when_sure`, `careful` |" in early
    assert "| made up | `when_sure`, `careful` |" in decision
    assert (tmp_path / "figures" / "early.png").stat().st_size > 10_000
