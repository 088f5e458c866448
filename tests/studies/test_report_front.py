"""Speed, error and cost: copies, counts and fits are right, and stored figures still hold."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest
from rigs.haart_folder import HAART, needs_haart
from rigs.stored_report import RESULTS

pytest.importorskip("torch", reason="needs the extra `train`")
pytest.importorskip("onnx", reason="needs the extra `train`")

import onnx

from touchd.drivers.recording import Recording, ideal_clock_ms, write_recordings
from touchd.model.classifier import SHIPPED_MODEL, Classifier
from touchd.model.settings import LENGTHS
from touchd.model.studies.checks.hard_cases import hand
from touchd.model.studies.hand import simulate
from touchd.model.studies.report import cost, front, int8, networks, sizes
from touchd.model.studies.report.front import Row
from touchd.model.studies.report.macs import multiply_adds
from touchd.model.studies.report.paper_tgc import PaperSettings
from touchd.model.studies.report.peak import idle_bytes, peak_bytes
from touchd.model.studies.report.results import Results
from touchd.model.training import haart
from touchd.model.training.recipe import HAART_RECIPE, final_jobs, read_recipe
from touchd.model.training.ship import HAART_MODEL

pytestmark = pytest.mark.timeout(180)
TOLERANCE = 0.004
"""A few windows may fall the other way on another processor."""


def shipped_by_hand(frames: int) -> int:
    """Count the shipped network's multiply-adds, layer by layer."""
    stem = 64 * 16 * (2 * 9) + 16 * 32 * (16 * 9) + 128 * 96
    motion = 4 * (3 * 96 * 192 + 96 * 96)
    encoder = 4 * 96 * 96 + 2 * 96 * 192
    attention = 2 * frames * 96
    return frames * (stem + motion + encoder + attention) + 288 * 96 + 96 * 7


def timed(name: str, ms: float, error: float | None) -> Row:
    cell = {"family": "touchd", "at": {"144": {"onnx_runtime": {"processor_ms": ms}}}}
    return Row(name, "float32", 144, cell, error, "measured")


def recordings(strengths: Sequence[float] = (1.0,) * 7) -> list[Recording]:
    """Return made-up recordings of all gestures, which press more or less."""
    return [
        Recording("T1", "foam", "fur", gesture, counts, ideal_clock_ms(432), "published")
        for gesture, strength in zip(haart.GESTURES, strengths, strict=True)
        for counts in [np.rint(hand(432) * strength).astype(np.uint16)]
    ]


@pytest.mark.parametrize("kind", ["dynamic", "static"])
def test_an_int8_copy_is_smaller_and_answers_alike(tmp_path: Path, kind: str) -> None:
    made = simulate([(gesture, 8.0) for gesture in haart.GESTURES], seed=0)
    if kind == "dynamic":
        copy = int8.dynamic(SHIPPED_MODEL, tmp_path)
    else:
        copy = int8.static(SHIPPED_MODEL, made, tmp_path)
    assert copy.stat().st_size < 0.8 * SHIPPED_MODEL.stat().st_size
    plain, small = Classifier.load(SHIPPED_MODEL), Classifier.load(copy)
    assert small.metadata == plain.metadata
    windows = haart.cut(made, 72).counts
    differences = small.batch_probabilities(windows) - plain.batch_probabilities(windows)
    assert np.abs(differences).mean() < 0.01


@pytest.mark.parametrize("frames", [1, 54, 144])
def test_multiply_adds_of_the_shipped_file_match_by_hand(frames: int) -> None:
    assert multiply_adds(HAART_MODEL, frames) == shipped_by_hand(frames)
    assert multiply_adds(HAART_MODEL, frames, windows=3) == 3 * shipped_by_hand(frames)


def test_multiply_adds_of_other_layers_match_by_hand(tmp_path: Path) -> None:
    def weight(name: str, *shape: int) -> Any:
        return onnx.numpy_helper.from_array(np.zeros(shape, np.float32), name)

    node = onnx.helper.make_node
    nodes = [
        node("Conv", ["counts", "kernel"], ["image"], group=2),  # (1, 4, 8, 8) to (1, 6, 6, 6)
        node("Flatten", ["image"], ["flat"]),  # (1, 216)
        node("Gemm", ["flat", "turned"], ["ten"], transB=1),
        node("MatMul", ["ten", "plain"], ["out"]),
    ]
    weights = [weight("kernel", 6, 2, 3, 3), weight("turned", 10, 216), weight("plain", 10, 7)]
    given = onnx.helper.make_tensor_value_info("counts", onnx.TensorProto.FLOAT, ["batch", "frames", 8, 8])
    answer = onnx.helper.make_empty_tensor_value_info("out")
    graph = onnx.helper.make_graph(nodes, "by hand", [given], [answer], weights)
    model = onnx.helper.make_model(graph, opset_imports=[onnx.helper.make_opsetid("", 18)], ir_version=10)
    onnx.save(model, tmp_path / "layers.onnx")
    assert multiply_adds(tmp_path / "layers.onnx", 4) == 6 * 6 * 6 * (2 * 3 * 3) + 216 * 10 + 10 * 7


def test_a_cost_law_is_recovered_from_its_values() -> None:
    costs = {n: 0.2 + 0.01 * n + 3e-5 * n * n for n in (9, 27, 54, 81, 144, 432)}
    found = cost.fit(costs, degree=2)
    assert found.coefficients == pytest.approx((0.2, 0.01, 3e-5))
    assert found.largest_miss == pytest.approx(0, abs=1e-6)
    assert sum(found.parts(144)) == pytest.approx(found.at(144)) == pytest.approx(costs[144])


def test_no_term_of_a_cost_law_is_negative() -> None:
    found = cost.fit({1: 1.0, 2: 2.5, 4: 5.0, 8: 10.0}, degree=2)
    assert min(found.coefficients) >= 0
    assert 0.1 < found.largest_miss < 0.3


def test_the_front_holds_only_undominated_networks() -> None:
    quick, good, beaten = timed("quick", 1.0, 0.3), timed("good", 3.0, 0.2), timed("beaten", 4.0, 0.25)
    unknown = timed("unknown", 0.1, None)
    assert front.front([beaten, good, unknown, quick]) == [quick, good]


def test_an_unfinished_training_gives_no_error_of_the_paper(tmp_path: Path) -> None:
    results = Results(tmp_path / "report.json")
    key = "paper/public/blocks6/frames144/epochs{}/seed0"
    results.put(key.format(10), {"accuracies": [0.5] * 10}, 1.0)
    assert front.trained_accuracies(results, "public", 144, 6) == []
    results.put(key.format(100), {"accuracies": [0.7] * 99 + [0.6]}, 1.0)
    assert front.trained_accuracies(results, "public", 144, 6) == [0.6]


def test_the_papers_printed_errors_are_those_of_its_tables() -> None:
    assert front.printed_error(81, 6) is None
    assert front.printed_error(144, 6) == pytest.approx(1 - 0.728)
    assert front.printed_error(144, 1) == pytest.approx(1 - 0.656)


def test_a_batch_takes_more_memory_than_a_window() -> None:
    none, window, batch = idle_bytes(), peak_bytes(HAART_MODEL, 144), peak_bytes(HAART_MODEL, 144, windows=16)
    assert 10e6 < none < window < batch


def test_every_size_differs_in_widths_only() -> None:
    recipe = read_recipe(HAART_RECIPE)
    shipped = final_jobs(recipe)[0].settings
    widths = {"stem_width": 16, "width": 96, "feed_forward": 192, "dense": 96}
    for job in sizes.jobs(recipe):
        assert msgspec.structs.replace(job.settings.network, **widths) == shipped.network
        assert (job.settings.seed, job.settings.epochs) == (shipped.seed, shipped.epochs)
        assert job.settings.augmentation == shipped.augmentation


def test_a_size_that_is_stored_is_not_trained_again(tmp_path: Path) -> None:
    for name in sizes.SHAPES:
        (tmp_path / f"{name}.onnx").touch()
    files = sizes.ready(tmp_path / "no recordings here", tmp_path / "runs", threads=1, stored=tmp_path)
    assert files == {name: tmp_path / f"{name}.onnx" for name in sizes.SHAPES}
    assert not (tmp_path / "runs").exists()


@pytest.mark.slow
def test_a_missing_size_is_trained_and_exported(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    shape = {"stem_width": 2, "width": 8, "feed_forward": 8, "dense": 8}
    monkeypatch.setattr(sizes, "SHAPES", {"touchd-8-wide": shape})
    recipe = read_recipe(HAART_RECIPE)
    quick = msgspec.structs.replace(recipe.settings, epochs=1, crops_per_recording=1, batch=7)
    recipe = msgspec.structs.replace(recipe, settings=quick)
    monkeypatch.setattr(sizes, "read_recipe", lambda path: recipe)
    write_recordings(tmp_path / "training.csv", recordings(), {})
    files = sizes.ready(tmp_path, tmp_path / "runs", threads=1, stored=tmp_path / "stored")
    classifier = Classifier.load(files["touchd-8-wide"])
    assert classifier.metadata.training["network"]["width"] == 8
    assert classifier.probabilities(hand(54)).shape == (7,)


@pytest.mark.parametrize("path", sorted(sizes.SIZES_FOLDER.glob("*.onnx")), ids=lambda path: path.stem)
def test_each_stored_size_is_as_declared(path: Path) -> None:
    classifier = Classifier.load(path)
    shape = classifier.metadata.training["network"]
    assert sizes.SHAPES[path.stem].items() <= shape.items()
    assert classifier.probabilities(hand(81)).sum() == pytest.approx(1, abs=1e-5)


@pytest.mark.slow
def test_ours_and_the_papers_are_timed_weighed_and_ours_scored(tmp_path: Path) -> None:
    asked = networks.ours({}, recordings(), tmp_path)
    asked += networks.papers(PaperSettings("public", frames=9, blocks=1, width=8, heads=2), tmp_path)
    asked += networks.hughes("hughes-crnn", 54, tmp_path)
    measured = front.measure(asked, recordings(), answers=2)
    filters = 18 * 64 * 16 * 27 + 6 * 16 * 32 * 16 * 27
    recurrence = 6 * 4 * 64 * (128 + 64)
    crnn = measured["front/hughes-crnn-54-frames/float32"]["at"]["54"]
    assert crnn["multiply_adds"] == filters + recurrence + 6 * 64 * 7
    shipped = measured["front/touchd/float32"]
    assert shipped["file_bytes"] == HAART_MODEL.stat().st_size
    assert shipped["peak_bytes"] > shipped["idle_bytes"]
    assert shipped["at"]["54"]["multiply_adds"] == shipped_by_hand(54)
    assert shipped["at"]["54"]["accuracy"] == pytest.approx(1 / 7, abs=1e-4)
    assert measured["front/touchd/int8"]["file_bytes"] < shipped["file_bytes"] / 2
    public = measured["front/tgc-public-9-frames-1-blocks/float32"]["at"]["9"]
    block = 4 * 8 * 8 + 2 * 9 * 8
    assert public["multiply_adds"] == 9 * (64 * 8 + block + 8 * 128 + 128 * 16 + 16 * 4) + 9 * 4 * 7
    assert min(public[runtime]["p50_ms"] for runtime in ("onnx_runtime", "pytorch_eager")) > 0


def test_pads_are_answered_in_a_batch_and_one_by_one() -> None:
    asked = cost.pads((1, 4))
    assert set(asked) <= set(cost.pad_keys())
    shapes = {key: [len(answer) for answer in ask()] for key, (_, ask) in asked.items()}
    assert shapes == {
        "cost/pads/1/batched": [1],
        "cost/pads/1/single": [1],
        "cost/pads/4/batched": [4],
        "cost/pads/4/single": [1, 1, 1, 1],
    }
    measured = cost.measure(asked, answers=2)
    assert measured["cost/pads/4/batched"]["p50_ms"] > 0
    assert measured["cost/pads/4/batched"]["peak_bytes"] > measured["cost/pads/4/single"]["peak_bytes"]


def test_stored_files_have_the_reported_size_and_work() -> None:
    files = {networks.SHIPPED: HAART_MODEL, **{p.stem: p for p in sizes.SIZES_FOLDER.glob("*.onnx")}}
    for name, path in files.items():
        cell = RESULTS.get(f"front/{name}/float32")
        assert cell["file_bytes"] == path.stat().st_size
        for frames in LENGTHS:
            assert cell["at"][str(frames)]["multiply_adds"] == multiply_adds(path, frames)


@pytest.mark.slow
@needs_haart
def test_a_sample_of_stored_errors_holds_again() -> None:
    assert HAART is not None
    test = haart.read_test(Path(HAART))
    small = sizes.SIZES_FOLDER / "touchd-24-wide.onnx"
    for name, path in ((networks.SHIPPED, HAART_MODEL), (small.stem, small)):
        cell = RESULTS.get(f"front/{name}/float32")
        for frames, accuracy in front.our_accuracies(path, test).items():
            assert cell["at"][frames]["accuracy"] == pytest.approx(accuracy, abs=TOLERANCE)
