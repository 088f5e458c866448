"""The paper's network, as printed and as in its code, and its training, which resumes to the same weights."""

from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("torch", reason="needs the extra `train`")

import torch
from rigs.haart_folder import HAART, haart_test_without_counts, needs_haart
from torch import nn

from touchd.drivers.recording import Recording, ideal_clock_ms
from touchd.model.classifier import Classifier
from touchd.model.studies import paper
from touchd.model.studies.checks import evaluate
from touchd.model.studies.paper import PaperCell, PaperTraining, train
from touchd.model.studies.paper_network import Attention, FeedForward, PaperSettings, PaperTGC, Variant
from touchd.model.studies.results import Results
from touchd.model.training import haart
from touchd.model.training.checkpoint import CheckpointError
from touchd.model.training.haart import GESTURES, Windows
from touchd.model.training.weights import touchd_1_files

pytestmark = pytest.mark.usefixtures("one_thread")
RESULTS = Results(paper.FILE)
TOLERANCE = 0.002
"""A window or two may fall the other way on another processor, or when probabilities are rounded."""
CELL = PaperCell("public", blocks=1, frames=9, epochs=2, seed=0)


def windows(seed: int) -> Windows:
    """Two windows per gesture; each gesture presses harder than the one before."""
    rng = np.random.default_rng(seed)
    labels = np.repeat(np.arange(len(GESTURES)), 2)
    counts = rng.integers(0, 8 * (labels[:, None, None, None] + 1), size=(len(labels), 9, 8, 8))
    return Windows(counts.astype(np.uint16), labels, np.repeat("P3", len(labels)), np.repeat("", len(labels)))


@pytest.fixture
def made(monkeypatch: pytest.MonkeyPatch) -> list[Recording]:
    """A short made-up recording of each gesture."""
    monkeypatch.setattr(haart, "PUBLISHED_FRAMES", 9)
    return [
        Recording("P3", "foam", "fur", gesture, counts, ideal_clock_ms(len(counts)), "published")
        for gesture, counts in zip(GESTURES, windows(0).counts[::2], strict=True)
    ]


@pytest.fixture
def results(tmp_path: Path) -> Results:
    return Results(tmp_path / "paper.json")


def training(cell: PaperCell = CELL) -> PaperTraining:
    return PaperTraining(cell, windows(0), windows(1), "cpu")


def test_an_interrupted_training_reaches_the_same_weights(tmp_path: Path) -> None:
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


def test_a_cell_keeps_every_epoch_and_the_last_ones_answers(
    results: Results, made: list[Recording], tmp_path: Path
) -> None:
    train(results, CELL, made, made, tmp_path)
    values = results.get(CELL.key)
    assert len(values["accuracies"]) == 2
    named = np.array(list(values["answers"]), dtype=np.int64)
    again = paper.macro_accuracy(named, haart.cut(made, 9).labels)
    assert again == pytest.approx(values["accuracies"][-1], abs=1e-5)


def test_more_epochs_continue_a_training(results: Results, made: list[Recording], tmp_path: Path) -> None:
    train(results, CELL, made, made, tmp_path)
    longer = PaperCell("public", 1, 9, epochs=3, seed=0)
    train(results, longer, made, made, tmp_path)
    before, after = (results.get(cell.key)["accuracies"] for cell in (CELL, longer))
    assert after[:2] == before
    with pytest.raises(CheckpointError, match="trained for 3 epochs already"):
        train(results, PaperCell("public", 1, 9, epochs=1, seed=0), made, made, tmp_path)


def test_a_row_shows_the_longest_training_with_six_blocks(results: Results) -> None:
    for blocks, epochs, accuracy in ((1, 100, 0.9), (6, 10, 0.5), (6, 60, 0.6), (8, 25, 0.8)):
        cell = PaperCell("public", blocks, 144, epochs, 0)
        results.put(cell.key, {"accuracies": [0.7, accuracy]}, 0.0)
    assert paper._row(results, paper.trained(results)) == ("6 / 60", "60.0")


@needs_haart
def test_the_papers_network_scores_as_its_stored_answers() -> None:
    recordings = haart_test_without_counts()
    labels = {frames: haart.cut(recordings, frames).labels for frames in evaluate.REPORTED_LENGTHS}
    for cell in paper.trained(RESULTS):
        values = RESULTS.get(cell.key)
        named = np.array(list(values["answers"]), dtype=np.int64)
        assert len(named) == values["windows"]
        again = paper.macro_accuracy(named, labels[cell.frames])
        assert again == pytest.approx(values["accuracies"][-1], abs=TOLERANCE), cell.key


@pytest.mark.slow
@needs_haart
@pytest.mark.parametrize(("file", "frames"), [(0, 54), (1, 144)])
def test_our_networks_score_in_the_papers_windows_as_stored(file: int, frames: int) -> None:
    stored = RESULTS.get(paper.our_key("published", frames))["accuracies"]
    assert len(stored) == len(touchd_1_files())
    recordings = haart.read_test(Path(str(HAART)))
    again = evaluate.score([(Classifier.load(touchd_1_files()[file]), recordings)], frames)
    assert again.accuracy == pytest.approx(stored[file], abs=TOLERANCE)


def test_the_printed_block_is_the_encoder_block_of_pytorch() -> None:
    torch.manual_seed(0)
    attention, forward = Attention(32, 4, 0.1).eval(), FeedForward(32, 64, 0.1).eval()
    theirs = nn.TransformerEncoderLayer(32, 4, 64, dropout=0.1, batch_first=True).eval()
    together = nn.Linear(32, 96)
    for name in ("weight", "bias"):
        parts = [getattr(layer, name) for layer in (attention.query, attention.key, attention.value)]
        setattr(together, name, nn.Parameter(torch.cat(parts)))
    layers = (together, attention.project, forward.layers[0], forward.layers[2], attention.norm, forward.norm)
    ours = [getattr(layer, name) for layer in layers for name in ("weight", "bias")]
    theirs.load_state_dict(dict(zip(theirs.state_dict(), ours, strict=True)))
    x = torch.randn(2, 9, 32)
    with torch.no_grad():
        torch.testing.assert_close(forward(attention(x)), theirs(x), rtol=1e-5, atol=1e-5)


@pytest.mark.parametrize("variant", ["printed", "public"])
@pytest.mark.parametrize("frames", [9, 72])
def test_each_answers_at_its_own_length(variant: Variant, frames: int) -> None:
    settings = PaperSettings(variant, frames, blocks=1, width=16, heads=4, inner=32)
    network = PaperTGC(settings, 7).eval()
    with torch.no_grad():
        assert network(torch.zeros(3, frames, 8, 8)).shape == (3, 7)
    with pytest.raises(RuntimeError):
        network(torch.zeros(3, frames + 1, 8, 8))
