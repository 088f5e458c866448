"""Training the paper's networks: resumable to the same weights, with every epoch kept."""

from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("torch", reason="needs the extra `train`")

import torch

from touchd.drivers.recording import Recording, ideal_clock_ms
from touchd.model.studies.report import paper_cells, paper_training
from touchd.model.studies.report.paper_cells import Grid, PaperCell, read_grid
from touchd.model.studies.report.paper_training import CHECKPOINT_NAME, PaperTraining, train, trained
from touchd.model.studies.report.results import Results, Study
from touchd.model.training import haart
from touchd.model.training.checkpoint import CheckpointError
from touchd.model.training.haart import GESTURES, Windows
from touchd.model.training.recipe import SettingsError

pytestmark = pytest.mark.usefixtures("one_thread")
GRID = Grid(learning_rate=1e-4, batch=8, bfloat16=False, whole=(), feasible=())
CELL = PaperCell("public", blocks=1, frames=9, epochs=2, seed=0)


def windows(seed: int) -> Windows:
    """Two windows a gesture; each gesture presses harder than the one before."""
    rng = np.random.default_rng(seed)
    labels = np.repeat(np.arange(len(GESTURES)), 2)
    counts = rng.integers(0, 8 * (labels[:, None, None, None] + 1), size=(len(labels), 9, 8, 8))
    return Windows(counts.astype(np.uint16), labels, np.repeat("P3", len(labels)), np.repeat("", len(labels)))


@pytest.fixture
def study(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Study:
    """A study over made-up windows, in an empty folder."""
    made = [
        Recording("P3", "foam", "fur", gesture, counts, ideal_clock_ms(len(counts)), "published")
        for gesture, counts in zip(GESTURES, windows(0).counts[::2], strict=True)
    ]
    monkeypatch.setattr(haart, "PUBLISHED_FRAMES", 9)
    monkeypatch.setattr(haart, "read_training", lambda folder: made)
    monkeypatch.setattr(haart, "read_test", lambda folder: made)
    docs = tmp_path / "docs"
    return Study(tmp_path, tmp_path / "runs", Results(docs / "report.json"), threads=1, docs=docs)


def training(cell: PaperCell = CELL) -> PaperTraining:
    return PaperTraining(cell, GRID, windows(0), windows(1), "cpu")


def test_a_cut_off_training_goes_on_to_the_same_weights(tmp_path: Path) -> None:
    cell = PaperCell("printed", blocks=1, frames=9, epochs=2, seed=0)
    whole = training(cell)
    whole.run_epoch()
    whole.save(tmp_path / "checkpoint.pt")
    whole.run_epoch()
    resumed = training(cell)
    resumed.resume(tmp_path / "checkpoint.pt")
    resumed.run_epoch()
    assert resumed.accuracies == whole.accuracies
    for name, value in whole.network.state_dict().items():
        torch.testing.assert_close(resumed.network.state_dict()[name], value, rtol=0.0, atol=0.0)


def test_every_epoch_is_scored_in_evaluation_mode() -> None:
    paper = training()
    probabilities = paper.run_epoch()
    assert paper.epoch == 1
    np.testing.assert_array_equal(probabilities, paper_training.answer(paper.network, windows(1).counts))
    assert paper.accuracies[-1] == paper_training.macro_accuracy(probabilities, windows(1).labels)


def test_a_cell_keeps_every_epoch_and_the_last_ones_answers(study: Study) -> None:
    train(study, GRID, CELL)
    values = study.results.get(CELL.key)
    assert len(values["accuracies"]) == len(values["losses"]) == 2
    with np.load(CELL.stored(study.docs)) as stored:
        again = paper_training.macro_accuracy(stored["probabilities"], stored["labels"].astype(np.int64))
    assert again == pytest.approx(values["accuracies"][-1], abs=1e-5)


def test_more_epochs_resume_into_another_cell(study: Study) -> None:
    train(study, GRID, CELL)
    longer = PaperCell("public", 1, 9, epochs=3, seed=0)
    train(study, GRID, longer)
    before, after = (study.results.get(cell.key)["accuracies"] for cell in (CELL, longer))
    assert after[:2] == before
    assert paper_cells.trained(study.results) == {("public", 1, 9): [longer]}
    assert trained(study, CELL) is None
    network = trained(study, longer)
    assert network is not None
    assert len(network.encoder) == 1


def test_a_longer_training_is_left_alone(study: Study, caplog: pytest.LogCaptureFixture) -> None:
    train(study, GRID, CELL)
    path = study.checkpoints / CELL.training / CHECKPOINT_NAME
    before = path.read_bytes()
    train(study, GRID, PaperCell("public", 1, 9, epochs=1, seed=0))
    assert "left as it is" in caplog.text
    assert path.read_bytes() == before
    assert study.results.keys() == [CELL.key]


def test_a_training_held_by_another_process_is_left(study: Study, caplog: pytest.LogCaptureFixture) -> None:
    folder = study.checkpoints / CELL.training
    folder.mkdir(parents=True)
    with paper_training.claim(folder) as claimed:
        assert claimed
        train(study, GRID, CELL)
    assert "another process" in caplog.text
    assert study.results.keys() == []


def test_a_damaged_checkpoint_is_named_in_one_line(study: Study) -> None:
    path = study.checkpoints / CELL.training / CHECKPOINT_NAME
    path.parent.mkdir(parents=True)
    path.write_bytes(b"no checkpoint")
    with pytest.raises(CheckpointError, match="move it away") as raised:
        train(study, GRID, CELL)
    assert "\n" not in str(raised.value)


def test_the_whole_grid_covers_tables_2_and_3() -> None:
    grid = read_grid()
    cells = {cell for entry in grid.whole for cell in entry.cells()}
    assert (grid.learning_rate, grid.batch) == (1e-4, 64)
    assert {cell.epochs for cell in cells} == {100}
    for variant in ("public", "printed"):
        own = [cell for cell in cells if cell.variant == variant]
        assert {cell.frames for cell in own if cell.blocks == 6} == {9, 27, 54, 72, 81, 108, 144, 216}
        assert {cell.blocks for cell in own if cell.frames == 144} == set(range(1, 9))
        assert {cell.seed for cell in own} == {0, 1, 2}


def test_a_mistake_in_the_grid_names_the_file(tmp_path: Path) -> None:
    path = tmp_path / "grid.yaml"
    path.write_text("learning_rate: 1.0e-4\nbatch: 64\nepoch: 3\n")
    with pytest.raises(SettingsError, match=r"grid\.yaml"):
        read_grid(path)


def test_networks_are_listed_by_variant_frames_and_blocks(tmp_path: Path) -> None:
    results = Results(tmp_path / "report.json")
    expected = [("public", 6, 54), ("public", 1, 144), ("public", 6, 144), ("printed", 1, 9)]
    for variant, blocks, frames in reversed(expected):
        results.put(PaperCell(variant, blocks, frames, 1, 0).key, {}, 0.0)  # type: ignore[arg-type]
    assert list(paper_cells.trained(results)) == expected
