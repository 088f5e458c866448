"""Pages show the stored figures, and the report's hold when measured again from stored files."""

import shutil
from collections.abc import Callable, Sequence
from itertools import product
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest
from rigs.haart_folder import HAART, needs_haart
from rigs.stored_report import DOCS, RESULTS

pytest.importorskip("torch", reason="needs the extra train")
pytest.importorskip("sklearn", reason="needs the extra `studies`")

from touchd.drivers.recording import Recording
from touchd.model.adapt.head import AdaptSettings
from touchd.model.adapt.threads import one_torch_thread
from touchd.model.classifier import SHIPPED_MODEL, Classifier
from touchd.model.studies import accuracy, adapting
from touchd.model.studies.checks import evaluate
from touchd.model.studies.checks.evaluate import read_scores
from touchd.model.studies.marked import fill
from touchd.model.studies.report import page, paper_cells, paper_training, representation, tables23
from touchd.model.studies.tracker import report as touch_page
from touchd.model.studies.tracker.figures import TouchReport
from touchd.model.training import haart
from touchd.model.training.recipe import read_recipe
from touchd.model.training.ship import SCORES_NAME

ALL_KEYS = RESULTS.keys()
PAPER_KEYS = RESULTS.keys(paper_cells.PREFIX)
TOLERANCE = 0.002
"""A window or two may fall the other way on another processor, or when probabilities are rounded."""


@pytest.fixture(scope="module")
def test_recordings() -> list[Recording]:
    """The recordings of the test participants, as published."""
    return haart.read_test(Path(str(HAART)))


@pytest.mark.parametrize(
    ("name", "tables", "others"),
    [
        ("report", lambda: page.tables(RESULTS), ()),
        (
            "accuracy",
            lambda: accuracy.tables(read_scores(SHIPPED_MODEL.with_name(SCORES_NAME))),
            (accuracy.SEEDS, accuracy.ONE_OUT),
        ),
        ("adapt", lambda: adapting.tables(stored("adapt.json", adapting.Measured)), ()),
        ("touch", lambda: touch_page.tables(stored("touch.json", TouchReport)), ()),
    ],
)
def test_a_page_shows_the_stored_figures(
    name: str, tables: Callable[[], dict[str, str]], others: Sequence[str], tmp_path: Path
) -> None:
    published, again = DOCS / f"{name}.md", tmp_path / "again.md"
    shutil.copy(published, again)
    fill(again, tables(), others)
    assert again.read_text(encoding="utf-8") == published.read_text(encoding="utf-8")


def stored(name: str, kind: Any) -> Any:
    return msgspec.json.decode((DOCS / name).read_bytes(), type=kind)


@pytest.fixture(scope="module")
def adapted() -> adapting.Measured:
    measured: adapting.Measured = stored("adapt.json", adapting.Measured)
    return measured


def test_what_adapting_gains_was_measured_with_the_settings_that_ship(adapted: adapting.Measured) -> None:
    assert adapted.settings == AdaptSettings()


def test_adapting_was_measured_on_everybody_in_every_setting(adapted: adapting.Measured) -> None:
    people = [name for fold in read_recipe().folds for name in sorted(fold)]
    expected = list(product(people, range(adapting.DRAWS), adapting.SHOTS))
    assert [(t.participant, t.draw, t.each) for t in adapted.trials] == expected


def test_a_person_of_the_second_study_gains_with_every_recording(adapted: adapting.Measured) -> None:
    own = [t for t in adapted.trials if t.participant.startswith("R")]
    after = [np.mean([t.after for t in own if t.each == each]) for each in adapting.SHOTS]
    assert np.mean([t.before for t in own]) < after[0] < after[1] < after[2]


def test_every_cell_says_which_command_commit_and_machine_made_it() -> None:
    for key in ALL_KEYS:
        cell = RESULTS.cell(key)
        assert "report" in cell.command, key
        assert cell.commit, key
        assert "cores" in cell.machine, key


@pytest.mark.parametrize("key", PAPER_KEYS)
def test_the_papers_network_scores_as_its_stored_answers(key: str) -> None:
    values = RESULTS.get(key)
    with np.load(paper_cells.parse(key).stored(DOCS)) as stored:
        labels = stored["labels"].astype(np.int64)
        again = paper_training.macro_accuracy(stored["probabilities"].astype(np.float64), labels)
    assert len(labels) == values["windows"]
    assert again == pytest.approx(values["accuracies"][-1], abs=TOLERANCE)


@needs_haart
@pytest.mark.parametrize("key", PAPER_KEYS)
def test_the_stored_answers_are_over_the_test_participants_windows(
    key: str, test_recordings: list[Recording]
) -> None:
    cell = paper_cells.parse(key)
    with np.load(cell.stored(DOCS)) as stored:
        np.testing.assert_array_equal(stored["labels"], haart.cut(test_recordings, cell.frames).labels)


@pytest.mark.slow
@needs_haart
def test_the_kept_network_of_the_papers_scores_as_reported(test_recordings: list[Recording]) -> None:
    (cell,) = paper_cells.trained(RESULTS)["public", 1, 144]
    windows = haart.cut(test_recordings, cell.frames)
    with one_torch_thread():
        probabilities = paper_training.answer(paper_training.load_kept(DOCS, cell), windows.counts)
    again = paper_training.macro_accuracy(probabilities, windows.labels)
    assert again == pytest.approx(RESULTS.get(cell.key)["accuracies"][-1], abs=TOLERANCE)


@needs_haart
@pytest.mark.parametrize(("file", "frames"), [(0, 54), (1, 144)])
def test_our_networks_score_in_the_papers_windows_as_reported(
    file: int, frames: int, test_recordings: list[Recording]
) -> None:
    reported = RESULTS.get(tables23.our_key("published", frames))["accuracies"]
    assert len(reported) == len(tables23.model_files())
    again = evaluate.score([(Classifier.load(tables23.model_files()[file]), test_recordings)], frames)
    assert again.accuracy == pytest.approx(reported[file], abs=TOLERANCE)


def test_the_nearest_windows_are_sought_among_other_participants_alone() -> None:
    features = np.array([[0.0], [0.1], [5.0], [5.2]])
    labels = np.array([0, 1, 1, 0])
    people = np.array(["T1", "T1", "T2", "T2"])
    windows = haart.Windows(np.zeros((4, 1, 8, 8), dtype=np.uint16), labels, people, people)
    # Each window's nearest neighbour is its own participant's, and must be skipped.
    assert representation.nearest_agree(features, windows) == 0.5
