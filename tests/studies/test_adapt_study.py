"""The figures of docs/adapt.md: of the settings that ship, and a sample holds when it is measured again."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pytest
from rigs.haart_folder import HAART, needs_haart

pytest.importorskip("torch", reason="needs the extra `train`")
pytestmark = pytest.mark.timeout(120)

from docs.studies.adapting.cells import DRAWS, FILE_NAME, SHOTS, TEST_PARTICIPANTS, Measured, read, write  # noqa: E402
from docs.studies.adapting.page import gains, tables  # noqa: E402
from docs.studies.adapting.study import draw, score  # noqa: E402
from docs.studies.marked import fill  # noqa: E402
from docs.studies.training import haart  # noqa: E402
from docs.studies.training.recipe import HAART_RECIPE, read_recipe  # noqa: E402
from model.adapt.adapt import Pretrained, adapt, prepare  # noqa: E402
from model.adapt.backbone import windows  # noqa: E402
from model.adapt.head import AdaptSettings  # noqa: E402
from model.settings import LENGTHS  # noqa: E402
from model.training.threads import one_torch_thread  # noqa: E402

DOCS = Path(__file__).parents[2] / "docs"
SAMPLE = ("T1", 0, 4)
TOLERANCE = 0.02
"""A window is 1.8 % of a gesture; three may fall the other way on another processor."""


@pytest.fixture(scope="module")
def study() -> Measured:
    return read(DOCS / FILE_NAME)


def test_the_figures_are_those_of_the_settings_that_ship(study: Measured) -> None:
    assert study.settings == AdaptSettings()


def test_everybody_was_measured_in_every_setting(study: Measured) -> None:
    people = {name for fold in read_recipe(HAART_RECIPE).folds for name in fold} | set(TEST_PARTICIPANTS)
    assert {(cell.participant, cell.draw, cell.each, cell.rehearsed) for cell in study.cells} == {
        (name, number, each, rehearsed)
        for name in people
        for number in range(DRAWS)
        for each in SHOTS
        for rehearsed in (False, True)
    }


def test_the_page_says_what_was_measured(study: Measured, tmp_path: Path) -> None:
    again = tmp_path / "adapt.md"
    shutil.copy(DOCS / "adapt.md", again)
    fill(again, tables(study))
    assert again.read_text(encoding="utf-8") == (DOCS / "adapt.md").read_text(encoding="utf-8")


def test_the_figures_survive_their_file(study: Measured, tmp_path: Path) -> None:
    write(study, tmp_path / FILE_NAME)
    assert read(tmp_path / FILE_NAME) == study


def test_the_person_adapted_to_gains_and_rehearsal_spares_the_others(study: Measured) -> None:
    """What the page claims, and what the settings were chosen for."""
    training = [cell for cell in study.cells if cell.participant not in TEST_PARTICIPANTS]
    of = {(row.each, row.rehearsed, row.frames): row for row in gains(training)}
    for frames in LENGTHS:
        assert 0 < of[1, False, frames].own.mean < of[4, False, frames].own.mean
        assert of[4, True, frames].others.mean > of[4, False, frames].others.mean
    assert of[4, False, 144].own.low > 0


@pytest.mark.slow
@needs_haart
def test_a_sample_of_the_figures_holds_when_measured_again(study: Measured) -> None:
    name, number, each = SAMPLE
    (cell,) = [
        cell
        for cell in study.cells
        if (cell.participant, cell.draw, cell.each, cell.rehearsed) == (*SAMPLE, False)
    ]
    with one_torch_thread():
        pretrained = Pretrained.shipped()
        own = haart.only(haart.realigned(haart.read_test(Path(str(HAART)))), (name,))
        first, rest = draw(own, name, number)
        chosen = [own[i] for gesture in first for i in gesture[:each]]
        adapted = adapt(pretrained, prepare(pretrained, chosen, study.settings), None, study.settings)
        evaluated = [own[i] for i in rest]
        again = score(
            adapted.head,
            adapted.temperatures,
            evaluated,
            windows(pretrained.backbone, evaluated),
            np.arange(len(evaluated)),
        )
    for frames, accuracy in cell.own_after.accuracy.items():
        assert again.accuracy[frames] == pytest.approx(accuracy, abs=TOLERANCE)
    assert again.calibration_error == pytest.approx(cell.own_after.calibration_error, abs=0.03)
