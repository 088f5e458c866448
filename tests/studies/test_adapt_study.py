"""The figures of docs/adapt.md are complete and of the shipped settings."""

import msgspec
import numpy as np
import pytest

pytest.importorskip("torch", reason="needs the extra `train`")

from docs.studies.adapting import DRAWS, FILE, SHOTS, Measured
from docs.studies.training.recipe import read_recipe
from model.adapt.head import AdaptSettings


@pytest.fixture(scope="module")
def measured() -> Measured:
    return msgspec.json.decode(FILE.read_bytes(), type=Measured)


def test_the_figures_are_those_of_the_settings_that_ship(measured: Measured) -> None:
    assert measured.settings == AdaptSettings()


def test_everybody_was_measured_in_every_setting(measured: Measured) -> None:
    assert [(t.participant, t.draw, t.each) for t in measured.trials] == [
        (name, number, each)
        for fold in read_recipe().folds
        for name in sorted(fold)
        for number in range(DRAWS)
        for each in SHOTS
    ]


def test_a_person_of_the_second_study_gains_with_every_recording(measured: Measured) -> None:
    own = [t for t in measured.trials if t.participant.startswith("R")]
    before = np.mean([t.before for t in own])
    after = [np.mean([t.after for t in own if t.each == each]) for each in SHOTS]
    assert before < after[0] < after[1] < after[2]
