"""What the robot would be told under each setting, on made-up answers and as stored."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest

from touchd.daemon.path.decide import DecisionSettings
from touchd.model.classifier import Classifier
from touchd.model.studies.decision import (
    FILE,
    FRAMES,
    Measured,
    Streams,
    at_limit,
    collect,
    draw,
    measure,
    tell,
)
from touchd.model.studies.folders import HELD_OUT
from touchd.model.studies.simulated import simulate

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


@pytest.fixture(scope="module")
def measured() -> Measured:
    return msgspec.json.decode(FILE.read_bytes(), type=Measured)


@pytest.mark.parametrize(("early", "after_s"), [("at_mark", 1.0), ("when_sure", 30 / 54)])
def test_a_sure_answer_is_told_once(late: Streams, early: Any, after_s: float) -> None:
    told = tell(late, DecisionSettings(early=early))
    assert np.mean([t.answers[0][1] for t in told]) == pytest.approx(after_s)
    assert all(t.right == [True] for t in told)


def test_a_right_answer_that_a_mark_undoes_is_harmful() -> None:
    undone = streams_sure_from([9] * 8, 0.9)
    undone.probabilities[:, 80:, 1:] = np.roll(undone.probabilities[:, 80:, 1:], 1, axis=2)
    assert all(t.harmed and not t.settled for t in tell(undone, DecisionSettings()))


def test_a_touch_detected_late_is_answered_at_the_next_mark(late: Streams) -> None:
    gentle = replace(late, detected=np.full(len(late.truth), 60))
    assert {t.answers[0][:2] for t in tell(gentle, DecisionSettings())} == {("revised", 1.5)}


def test_windows_are_answered_at_the_first_sure_frame(late: Streams) -> None:
    found = at_limit(late, 0.7)
    assert found.mean_s == pytest.approx(30 / 54)
    assert found.accuracy == 1.0


def test_a_real_network_follows_each_touch_frame_by_frame(classifier: Classifier) -> None:
    made = simulate([("notouch", 9.0), ("pat", 8.0), ("constant", 8.0)], 2)
    streams = collect([(classifier, made)], "made up")
    assert [classifier.labels[place] for place in streams.truth] == ["pat", "constant"]
    assert streams.probabilities.shape == (2, FRAMES, len(classifier.labels))
    assert (streams.probabilities[:, -1].argmax(axis=1) == streams.truth).all()
    without = collect([(classifier, made)], "made up", missing=("pat",)).probabilities
    assert (without[:, :, classifier.labels.index("pat")] == 0).all()
    assert without.sum(axis=2) == pytest.approx(1.0, abs=1e-5)


def test_the_default_tells_early_rightly_and_seldom_harms(measured: Measured) -> None:
    assert measured.default.right_when_told_early >= 0.85
    assert measured.default.changed <= 0.10
    assert measured.default.harmed <= 0.02


def test_confidence_is_calibrated_at_every_stage(measured: Measured) -> None:
    assert all(round(stage.calibration_error, 2) <= 0.05 for stage in measured.studies[HELD_OUT].stages)


def test_the_figure_is_drawn_from_the_figures(tmp_path: Path) -> None:
    few = streams_sure_from([28, 29, 30, 31], 0.9)
    made = measure({HELD_OUT: few, "made up": few}, few, few, {54: 0.8, 144: 0.9})
    draw(made, tmp_path / "decision.png")
    assert (tmp_path / "decision.png").stat().st_size > 10_000
