"""The classifier: answers at any length, and one clear line for unusable files and windows."""

from pathlib import Path

import msgspec
import numpy as np
import pytest

from docs.studies.checks.hard_cases import checkerboard, flat, hand
from docs.studies.checks.stability import chunked
from drivers.frame import FRAME_RATE_HZ
from model.classifier import (
    MAX_FILE_BYTES,
    METADATA_KEY,
    SHIPPED_MODEL,
    Classifier,
    ModelError,
    ModelInputError,
    ModelMetadata,
)
from model.settings import LENGTHS

GESTURES = ("constant", "notouch", "pat", "rub", "scratch", "stroke", "tickle")


@pytest.fixture(scope="module")
def shipped() -> Classifier:
    return Classifier.load()


def refusal(path: Path) -> str:
    with pytest.raises(ModelError) as raised:
        Classifier.load(path)
    message = str(raised.value)
    assert message.startswith(f"{path}: ")
    assert "\n" not in message
    return message.removeprefix(f"{path}: ")


def test_the_shipped_file_is_at_most_5_megabytes() -> None:
    assert SHIPPED_MODEL.stat().st_size <= 5_000_000


def test_the_shipped_model_says_what_it_is(shipped: Classifier) -> None:
    assert shipped.labels == GESTURES
    assert shipped.metadata.lengths == LENGTHS
    assert shipped.metadata.frame_rate_hz == FRAME_RATE_HZ
    assert shipped.metadata.framing == "live"
    assert shipped.metadata.max_length >= 216
    assert set(shipped.metadata.temperatures) == {str(length) for length in LENGTHS}
    assert shipped.name
    assert shipped.metadata.training


def test_every_length_up_to_the_longest_is_answered(shipped: Classifier) -> None:
    longest = shipped.metadata.max_length
    for length in (*range(1, 20), *LENGTHS, 216, longest):
        probabilities = shipped.probabilities(hand(length))
        assert probabilities.shape == (7,)
        assert probabilities.dtype == np.float64
        assert probabilities.sum() == pytest.approx(1.0, abs=1e-6)


def test_a_pad_at_rest_is_notouch_a_hand_is_not(shipped: Classifier) -> None:
    at_rest = np.random.default_rng(0).integers(4, size=(144, 8, 8))
    assert shipped.labels[shipped.probabilities(at_rest).argmax()] == "notouch"
    assert shipped.labels[shipped.probabilities(hand(144)).argmax()] != "notouch"


@pytest.mark.parametrize("dtype", [np.uint16, np.int64, np.float32, np.float64])
def test_counts_may_be_of_any_number_type(shipped: Classifier, dtype: type) -> None:
    expected = shipped.probabilities(hand(54))
    assert np.array_equal(shipped.probabilities(hand(54).astype(dtype)), expected)


def test_a_window_may_lie_anywhere_in_memory(shipped: Classifier) -> None:
    long = np.repeat(hand(108), 2, axis=0)
    assert np.array_equal(shipped.probabilities(long[::2]), shipped.probabilities(hand(108)))


def test_the_window_is_left_as_it_was(shipped: Classifier) -> None:
    window = hand(54)
    window.flags.writeable = False
    shipped.probabilities(window)
    assert np.array_equal(window, hand(54))


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf, -1.0, -1e-3, 1024.0, 1e30])
def test_a_count_that_no_pad_can_send_is_refused(shipped: Classifier, bad: float) -> None:
    window = hand(54)
    window[20, 3, 4] = bad
    with pytest.raises(ModelInputError, match="counts must be finite and within 0 to 1023"):
        shipped.probabilities(window)


@pytest.mark.parametrize("shape", [(54, 8), (54, 10, 10), (54, 64), (54, 8, 8, 1), (8, 8), (54, 8, 7)])
def test_another_shape_is_refused(shipped: Classifier, shape: tuple[int, ...]) -> None:
    with pytest.raises(ModelInputError, match=r"expected frames of shape \(T, 8, 8\), got \("):
        shipped.probabilities(np.zeros(shape, dtype=np.uint16))


def test_an_empty_or_too_long_window_is_refused(shipped: Classifier) -> None:
    longest = shipped.metadata.max_length
    for length in (0, longest + 1):
        with pytest.raises(ModelInputError, match=f"{length} frames; the model takes 1 to {longest}"):
            shipped.probabilities(np.zeros((length, 8, 8), dtype=np.uint16))


@pytest.mark.parametrize("begun", [0, 26, 53])
def test_touches_side_by_side_are_answered_as_alone(shipped: Classifier, begun: int) -> None:
    windows = [hand(54), checkerboard(54), flat(200.0, 54)]
    states = [shipped.step(window[:begun])[1] if begun else None for window in windows]
    halves = [(window[begun:40], window[40:]) if begun < 40 else (window[begun:],) for window in windows]
    for frames in zip(*halves, strict=True):
        answers, states = zip(*shipped.steps(frames, states), strict=True)
    for answer, window in zip(answers, windows, strict=True):
        assert answer == pytest.approx(shipped.probabilities(window), abs=1e-5)


@pytest.mark.parametrize(("name", "why"), [("no.onnx", "No such file or directory"), (".", "Is a directory")])
def test_an_unreadable_file_is_named(tmp_path: Path, name: str, why: str) -> None:
    message = refusal(tmp_path / name)
    assert message == f"the model cannot be read ({why}); check `model` in the configuration"


@pytest.mark.parametrize(
    "content",
    [b"", b"not onnx", b"\x08\x0a" + bytes(1000), SHIPPED_MODEL.read_bytes()[:500_000]],
    ids=["empty", "text", "zeros", "half a model"],
)
def test_a_file_that_is_not_onnx_is_refused(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "model.onnx"
    path.write_bytes(content)
    assert "ONNX Runtime refuses the file" in refusal(path)


def test_a_huge_file_is_refused_unread(tmp_path: Path) -> None:
    path = tmp_path / "model.onnx"
    with path.open("wb") as file:
        file.truncate(MAX_FILE_BYTES + 1)
    assert refusal(path) == "larger than 32 MiB; that is no touchd model"


class TestOtherModels:
    """Models that ONNX Runtime accepts and touchd refuses; made from the shipped one with onnx."""

    @pytest.fixture(autouse=True)
    def _onnx(self) -> None:
        self.onnx = pytest.importorskip("onnx", reason="needs the extra `train`")

    def changed(self, path: Path, **changes: object) -> Path:
        """Write the shipped model with other metadata to `path`."""
        proto = self.onnx.load(SHIPPED_MODEL)
        stored = msgspec.json.decode(proto.metadata_props[0].value, type=ModelMetadata)
        proto.metadata_props[0].value = msgspec.json.encode(
            msgspec.structs.replace(stored, **changes)
        ).decode()
        self.onnx.save(proto, path)
        return path

    def tiny_graph(self, path: Path, name: str, shape: list[object], classes: int) -> Path:
        """Write a model of one constant with the shipped model's metadata."""
        helper, kind = self.onnx.helper, self.onnx.TensorProto.FLOAT
        constant = helper.make_tensor("even", kind, [1, classes], [1.0 / classes] * classes)
        graph = helper.make_graph(
            [helper.make_node("Identity", ["even"], ["probabilities"])],
            "graph",
            [helper.make_tensor_value_info(name, kind, shape)],
            [helper.make_tensor_value_info("probabilities", kind, [1, classes])],
            [constant],
        )
        proto = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 18)])
        proto.ir_version = 9
        proto.metadata_props.append(self.onnx.load(SHIPPED_MODEL).metadata_props[0])
        self.onnx.save(proto, path)
        return path

    def test_a_stateless_file_also_answers_frame_by_frame(self, tmp_path: Path) -> None:
        proto = self.onnx.load(SHIPPED_MODEL)
        del proto.graph.input[1:]
        self.onnx.save(proto, tmp_path / "m.onnx")
        without = Classifier.load(tmp_path / "m.onnx")
        assert not without.states
        assert chunked(without, hand(54), (20, 1, 7)) <= 1e-6

    def test_a_file_for_one_state_answers_touches_in_turn(self, tmp_path: Path) -> None:
        proto = self.onnx.load(SHIPPED_MODEL)
        for entry in proto.graph.input[1:]:
            entry.type.tensor_type.shape.dim[0].dim_value = 1
        self.onnx.save(proto, tmp_path / "m.onnx")
        before, windows = Classifier.load(tmp_path / "m.onnx"), [hand(20), checkerboard(20)]
        _, states = zip(*before.steps([window[:9] for window in windows], [None, None]), strict=True)
        answers = before.steps([window[9:] for window in windows], states)
        for (answer, _), window in zip(answers, windows, strict=True):
            assert answer == pytest.approx(before.probabilities(window), abs=1e-5)

    def broken(self, path: Path, values: list[float], shape: list[int], endless: bool = False) -> str:
        """Return why a model that answers these values, or never, is refused."""
        self.tiny_graph(path, "counts", ["batch", "frames", 8, 8], 7)
        proto, helper, kind = self.onnx.load(path), self.onnx.helper, self.onnx.TensorProto
        proto.graph.initializer[0].CopyFrom(helper.make_tensor("even", kind.FLOAT, shape, values))
        proto.graph.output[0].CopyFrom(helper.make_tensor_value_info("probabilities", kind.FLOAT, shape))
        if endless:
            info = helper.make_tensor_value_info
            steps = [("go", "still"), ("held", "kept")]
            body = helper.make_graph(
                [helper.make_node("Identity", [before], [after]) for before, after in steps],
                "body",
                [info("turn", kind.INT64, []), info("go", kind.BOOL, []), info("held", kind.FLOAT, shape)],
                [info("still", kind.BOOL, []), info("kept", kind.FLOAT, shape)],
            )
            proto.graph.initializer.append(helper.make_tensor("yes", kind.BOOL, [], [True]))
            loop = helper.make_node("Loop", ["", "yes", "even"], ["probabilities"], body=body)
            proto.graph.node[0].CopyFrom(loop)
        self.onnx.save(proto, path)
        return refusal(path)

    def test_answers_that_are_no_probabilities_are_refused(self, tmp_path: Path) -> None:
        nan = [float("nan")] * 7
        assert "no probabilities" in self.broken(tmp_path / "nan.onnx", nan, [1, 7])
        assert "no probabilities" in self.broken(tmp_path / "large.onnx", [1.0] * 7, [1, 7])
        assert "shape ()" in self.broken(tmp_path / "scalar.onnx", [1.0], [])
        assert "shape (7,)" in self.broken(tmp_path / "rank.onnx", [1 / 7] * 7, [7])

    def test_an_additional_output_is_refused(self, tmp_path: Path) -> None:
        path = self.tiny_graph(tmp_path / "m.onnx", "counts", ["batch", "frames", 8, 8], 7)
        proto, helper = self.onnx.load(path), self.onnx.helper
        proto.graph.node.append(helper.make_node("Identity", ["even"], ["odd"]))
        proto.graph.output.append(helper.make_tensor_value_info("odd", self.onnx.TensorProto.FLOAT, [1, 7]))
        self.onnx.save(proto, path)
        assert "another output than probabilities: odd" in refusal(path)

    def test_a_graph_without_an_end_is_refused_in_time(
        self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        monkeypatch.setattr("model.classifier.TRIAL_S", 0.5)
        assert "no answer within 0.5 s" in self.broken(tmp_path / "m.onnx", [1 / 7] * 7, [1, 7], endless=True)

    def test_without_metadata_it_is_no_touchd_model(self, tmp_path: Path) -> None:
        path = self.tiny_graph(tmp_path / "m.onnx", "counts", ["batch", "frames", 8, 8], 7)
        proto = self.onnx.load(path)
        del proto.metadata_props[:]
        self.onnx.save(proto, path)
        assert "not a touchd model (it carries no metadata)" in refusal(path)

    @pytest.mark.parametrize("stored", ["{", "[]", '{"name": "x"}'])
    def test_damaged_metadata_is_refused(self, tmp_path: Path, stored: str) -> None:
        path = self.tiny_graph(tmp_path / "m.onnx", "counts", ["batch", "frames", 8, 8], 7)
        proto = self.onnx.load(path)
        assert proto.metadata_props[0].key == METADATA_KEY
        proto.metadata_props[0].value = stored
        self.onnx.save(proto, path)
        assert "its touchd metadata is damaged" in refusal(path)

    @pytest.mark.parametrize(
        ("name", "shape", "classes", "message"),
        [
            (
                "counts",
                ["batch", "frames", 10, 10],
                7,
                "not any number of 8x8 taxels' counts",
            ),
            ("counts", ["batch", "frames", 64], 7, "not any number of 8x8 taxels' counts"),
            ("pixels", ["batch", "frames", 8, 8], 7, "its inputs are [('pixels'"),
            ("counts", ["batch", 144, 8, 8], 7, "not any number of 8x8 taxels' counts"),
            ("counts", [1, "frames", 8, 8], 7, "not any number of 8x8 taxels' counts"),
            ("counts", ["batch", "frames", 8, 8], 6, "6 outputs for 7 labels; export it again"),
        ],
    )
    def test_another_shape_is_refused(
        self, tmp_path: Path, name: str, shape: list[object], classes: int, message: str
    ) -> None:
        assert message in refusal(self.tiny_graph(tmp_path / "m.onnx", name, shape, classes))

    @pytest.mark.parametrize(
        ("changes", "message"),
        [
            ({"frame_rate_hz": 100.0}, "made for 100.0 Hz, the pad is read at 54.0 Hz"),
            ({"framing": "published"}, "made for published framing; a pad sends live frames"),
            ({"labels": ("yes", "no")}, "7 outputs for 2 labels"),
        ],
    )
    def test_a_model_for_another_pad_is_refused(
        self, tmp_path: Path, changes: dict[str, object], message: str
    ) -> None:
        assert message in refusal(self.changed(tmp_path / "m.onnx", **changes))

    def test_weights_outside_the_file_are_refused(
        self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        path = tmp_path / "m.onnx"
        self.onnx.save_model(
            self.onnx.load(SHIPPED_MODEL), path, save_as_external_data=True, location="weights.bin"
        )
        assert (tmp_path / "weights.bin").stat().st_size > 100_000
        monkeypatch.chdir(tmp_path)
        assert "ONNX Runtime refuses the file" in refusal(path)

    def test_an_unknown_operator_is_refused(self, tmp_path: Path) -> None:
        path = self.tiny_graph(tmp_path / "m.onnx", "counts", ["batch", "frames", 8, 8], 7)
        proto = self.onnx.load(path)
        proto.graph.node[0].op_type = "Telepathy"
        self.onnx.save(proto, path)
        assert "ONNX Runtime refuses the file" in refusal(path)
