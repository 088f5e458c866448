"""The measured decisions over a touch, and the defaults chosen from them."""

import os
from pathlib import Path

import msgspec
import numpy as np
import pytest
from rigs.haart_folder import needs_haart
from rigs.stored_report import DOCS

from touchd.daemon.decide import DecisionSettings
from touchd.drivers.recording import Selection, read_recordings
from touchd.model.classifier import SHIPPED_MODEL
from touchd.model.studies.decision.measure import Said, Told, decide, listen
from touchd.model.studies.decision.report import StreamReport, choose
from touchd.model.studies.tracker.measure import spliced
from touchd.model.training import haart
from touchd.model.training.haart import TRAINING_FILE, find

LABELS = ("constant", "notouch", "pat", "rub", "scratch", "stroke", "tickle")


@pytest.fixture(scope="module")
def measured() -> StreamReport:
    return msgspec.json.decode((DOCS / "decision.json").read_bytes(), type=StreamReport)


def sure_of(gesture: str, confidence: float) -> np.ndarray:
    rest = (1.0 - confidence) / (len(LABELS) - 1)
    return np.array([confidence if label == gesture else rest for label in LABELS])


def test_the_defaults_are_the_point_that_the_rule_picks(measured: StreamReport) -> None:
    picked, defaults = choose(measured.curve), DecisionSettings()
    assert measured.default == picked
    assert (defaults.speak_above, defaults.revise_margin) == (picked.speak_above, picked.revise_margin)


def test_confidence_is_calibrated_at_every_stage(measured: StreamReport) -> None:
    assert all(stage.calibration_error <= 0.05 for stage in measured.stages)


def test_a_right_answer_made_wrong_counts_as_harm() -> None:
    said = Said("pat", (("early", 1.0, sure_of("pat", 0.9)), ("final", 2.67, sure_of("rub", 0.9))))
    told = decide(said, DecisionSettings(), LABELS)
    assert told == Told((("early", 1.0, True), ("final", 2.67, False)))
    assert told.harmed
    assert told.settled_s is None


def test_a_touch_is_settled_once_the_right_answer_stays() -> None:
    said = Said("pat", (("early", 1.0, sure_of("rub", 0.9)), ("revised", 1.5, sure_of("pat", 0.9))))
    told = decide(said, DecisionSettings(), LABELS)
    assert not told.harmed
    assert told.settled_s == 1.5


@pytest.mark.slow
@needs_haart
def test_a_participant_is_answered_by_an_unseen_network() -> None:
    pytest.importorskip("torch", reason="needs the extra train")
    from touchd.model.training.ship import left_out_split

    path = find(Path(os.environ["TOUCHD_HAART"]), TRAINING_FILE)
    of_one = haart.realigned(read_recordings(path, Selection(participants=("P8",))))
    classifier = next(fold for fold, recordings in left_out_split(SHIPPED_MODEL.parent, of_one) if recordings)
    said = list(listen(spliced(of_one, level_rest=True), classifier))
    final = [(touch, p) for touch in said for stage, _, p in touch.answers if stage == "final"]
    right = [LABELS[p.argmax()] == touch.gesture for touch, p in final]
    assert len(said) >= 70
    assert np.mean(right) >= 0.8
