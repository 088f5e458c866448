"""The classifier: answers at any length, and one clear line for unusable files and windows."""

import os
import random
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest

from touchd.drivers.frame import FRAME_RATE_HZ
from touchd.model.classifier import (
    MAX_FILE_BYTES,
    METADATA_KEY,
    SHIPPED_MODEL,
    Classifier,
    ModelError,
    ModelMetadata,
    digest_file,
    load_own,
    subtract_high_rest,
)
from touchd.model.settings import LENGTHS
from touchd.model.studies.checks.hard_cases import hand
from touchd.model.studies.checks.stability import chunked

ANY_WINDOW = ("batch", "frames", 8, 8)
GESTURES = ("constant", "notouch", "pat", "rub", "scratch", "stroke", "tickle", "other")


def refusal(path: Path) -> str:
    with pytest.raises(ModelError) as raised:
        load_own(path)
    message = str(raised.value)
    assert message.startswith(f"{path}: ")
    assert "\n" not in message
    return message.removeprefix(f"{path}: ")


def test_the_shipped_model_describes_itself(classifier: Classifier) -> None:
    assert SHIPPED_MODEL.stat().st_size <= 5_000_000
    assert load_own(SHIPPED_MODEL).metadata == classifier.metadata
    assert classifier.labels == GESTURES
    assert classifier.metadata.lengths == LENGTHS
    assert classifier.metadata.frame_rate_hz == FRAME_RATE_HZ
    assert classifier.metadata.framing == "live"
    assert classifier.metadata.max_length >= 216
    assert set(classifier.metadata.temperatures) == {str(length) for length in LENGTHS}
    assert classifier.name
    assert classifier.metadata.training


def test_every_length_up_to_the_longest_is_answered(classifier: Classifier) -> None:
    longest = classifier.metadata.max_length
    for length in (*range(1, 20), *LENGTHS, 216, longest):
        probabilities = classifier.probabilities(hand(length))
        assert probabilities.shape == (len(GESTURES),)
        assert probabilities.dtype == np.float64
        assert probabilities.sum() == pytest.approx(1.0, abs=1e-6)


def test_a_pad_at_rest_is_notouch_a_hand_is_not(classifier: Classifier) -> None:
    at_rest = np.random.default_rng(0).integers(4, size=(144, 8, 8))
    assert classifier.labels[classifier.probabilities(at_rest).argmax()] == "notouch"
    assert classifier.labels[classifier.probabilities(hand(144)).argmax()] != "notouch"


@pytest.mark.parametrize("dtype", [np.uint16, np.float64])
def test_counts_may_be_of_any_number_type(classifier: Classifier, dtype: type) -> None:
    expected = classifier.probabilities(hand(54))
    assert np.array_equal(classifier.probabilities(hand(54).astype(dtype)), expected)


@pytest.mark.parametrize("bad", [np.nan, np.inf, -1e-3, 1024.0])
def test_a_count_that_no_pad_can_send_is_refused(classifier: Classifier, bad: float) -> None:
    window = hand(54)
    window[20, 3, 4] = bad
    with pytest.raises(ValueError, match="8x8 counts from 0 to 1023"):
        classifier.probabilities(window)


@pytest.mark.parametrize("shape", [(54, 64), (54, 8, 8, 1), (8, 8), (54, 8, 7), (0, 8, 8), (433, 8, 8)])
def test_another_shape_is_refused(classifier: Classifier, shape: tuple[int, ...]) -> None:
    wanted = rf"takes 1 to 432 frames of 8x8 counts .* is \({shape[0]}, "
    with pytest.raises(ValueError, match=wanted):
        classifier.probabilities(np.zeros(shape, dtype=np.uint16))


def huge(path: Path) -> None:
    with path.open("wb") as file:
        file.truncate(MAX_FILE_BYTES + 1)


def holding(content: bytes) -> Callable[[Path], object]:
    return lambda path: path.write_bytes(content)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda path: None, "the model cannot be read (No such file or directory); check `model` in the"),
        (Path.mkdir, "the model cannot be read (Is a directory); check `model` in the configuration"),
        (os.mkfifo, "is not a file; check `model` in the configuration"),
        (huge, "larger than 32 MiB; not a touchd model"),
        (holding(b"not onnx"), "ONNX Runtime refuses the file"),
        (holding(SHIPPED_MODEL.read_bytes()[:500_000]), "ONNX Runtime refuses the file"),
    ],
    ids=["missing", "folder", "pipe", "huge", "text", "half a model"],
)
def test_a_file_that_is_not_a_model_is_refused(
    tmp_path: Path, make: Callable[[Path], object], message: str
) -> None:
    make(tmp_path / "model.onnx")
    assert refusal(tmp_path / "model.onnx").startswith(message)


def test_the_shipped_file_with_flipped_bits_is_refused(tmp_path: Path) -> None:
    whole, digest = SHIPPED_MODEL.read_bytes(), digest_file(SHIPPED_MODEL)
    path = tmp_path / SHIPPED_MODEL.name
    digest_file(path).write_text(digest.read_text())
    for place in random.Random(1).sample(range(len(whole)), 20):
        flipped = bytearray(whole)
        flipped[place] ^= 1 << place % 8
        path.write_bytes(flipped)
        assert "damaged, its CRC-32 is not that in touchd.onnx.crc32" in refusal(path)
    path.write_bytes(whole)
    Classifier.load(path)


class TestOtherModels:
    """Models that ONNX Runtime accepts and touchd refuses; made from the shipped one with onnx."""

    @pytest.fixture(autouse=True)
    def _onnx(self, tmp_path: Path) -> None:
        self.onnx = pytest.importorskip("onnx", reason="needs the extra `train`")
        self.path = tmp_path / "m.onnx"

    def saved(self, proto: Any) -> Path:
        self.onnx.save(proto, self.path)
        return self.path

    def shipped(self) -> Any:
        return self.onnx.load(SHIPPED_MODEL)

    def tiny(
        self, name: str = "counts", shape: Sequence[object] = ANY_WINDOW, classes: int = len(GESTURES)
    ) -> Any:
        """Return a model of one constant with the shipped model's metadata."""
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
        proto.metadata_props.append(self.shipped().metadata_props[0])
        return proto

    def test_a_stateless_file_also_answers_frame_by_frame(self) -> None:
        proto = self.shipped()
        del proto.graph.input[1:]
        without = Classifier.load(self.saved(proto))
        assert not without.states
        assert chunked(without, hand(54), (20, 1, 7)) <= 1e-6

    @pytest.mark.parametrize(
        ("values", "shape", "message"),
        [
            ([float("nan")] * 8, [1, 8], "not probabilities"),
            ([1.0] * 8, [1, 8], "not probabilities"),
            ([1.0], [], "shape ()"),
            ([1 / 8] * 8, [8], "shape (8,)"),
        ],
        ids=["nan", "too large", "scalar", "rank"],
    )
    def test_outputs_that_are_not_probabilities_are_refused(
        self, values: list[float], shape: list[int], message: str
    ) -> None:
        proto, helper, kind = self.tiny(), self.onnx.helper, self.onnx.TensorProto.FLOAT
        proto.graph.initializer[0].CopyFrom(helper.make_tensor("even", kind, shape, values))
        proto.graph.output[0].CopyFrom(helper.make_tensor_value_info("probabilities", kind, shape))
        assert message in refusal(self.saved(proto))

    def test_a_graph_without_an_end_is_refused_in_time(self, monkeypatch: pytest.MonkeyPatch) -> None:
        monkeypatch.setattr("touchd.model.classifier.TRIAL_S", 0.5)
        helper, kind = self.onnx.helper, self.onnx.TensorProto
        info = helper.make_tensor_value_info
        steps = [("go", "still"), ("held", "kept")]
        body = helper.make_graph(
            [helper.make_node("Identity", [before], [after]) for before, after in steps],
            "body",
            [info("turn", kind.INT64, []), info("go", kind.BOOL, []), info("held", kind.FLOAT, [1, 7])],
            [info("still", kind.BOOL, []), info("kept", kind.FLOAT, [1, 7])],
        )
        proto = self.tiny()
        proto.graph.initializer.append(helper.make_tensor("yes", kind.BOOL, [], [True]))
        loop = helper.make_node("Loop", ["", "yes", "even"], ["probabilities"], body=body)
        proto.graph.node[0].CopyFrom(loop)
        assert "no answer within 0.5 s" in refusal(self.saved(proto))

    def test_a_file_without_metadata_is_refused(self) -> None:
        proto = self.tiny()
        del proto.metadata_props[:]
        assert "not a touchd model (it carries no metadata)" in refusal(self.saved(proto))

    @pytest.mark.parametrize("stored", ["{", "[]", '{"name": "x"}'])
    def test_damaged_metadata_is_refused(self, stored: str) -> None:
        proto = self.tiny()
        assert proto.metadata_props[0].key == METADATA_KEY
        proto.metadata_props[0].value = stored
        assert "its touchd metadata is damaged" in refusal(self.saved(proto))

    @pytest.mark.parametrize(
        ("name", "shape", "classes", "message"),
        [
            ("counts", ["batch", "frames", 64], 8, "gives no answer for a pad at rest"),
            ("pixels", ["batch", "frames", 8, 8], 8, "gives no answer for a pad at rest"),
            ("counts", ["batch", 144, 8, 8], 8, "gives no answer for a pad at rest"),
            ("counts", ["batch", "frames", 8, 8], 6, "6 outputs for 8 labels; export it again"),
        ],
    )
    def test_another_shape_is_refused(
        self, name: str, shape: list[object], classes: int, message: str
    ) -> None:
        assert message in refusal(self.saved(self.tiny(name, shape, classes)))

    @pytest.mark.parametrize(
        ("changes", "message"),
        [
            ({"frame_rate_hz": 100.0}, "made for 100.0 Hz, the pad is read at 54.0 Hz"),
            ({"framing": "published"}, "made for published framing; a pad sends live frames"),
            ({"labels": ("yes", "no")}, "8 outputs for 2 labels"),
        ],
    )
    def test_a_model_for_another_pad_is_refused(self, changes: dict[str, object], message: str) -> None:
        proto = self.shipped()
        stored = msgspec.json.decode(proto.metadata_props[0].value, type=ModelMetadata)
        changed = msgspec.structs.replace(stored, **changes)
        proto.metadata_props[0].value = msgspec.json.encode(changed).decode()
        assert message in refusal(self.saved(proto))

    def test_weights_outside_the_file_are_refused(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.onnx.save_model(self.shipped(), self.path, save_as_external_data=True, location="weights.bin")
        assert self.path.with_name("weights.bin").stat().st_size > 100_000
        monkeypatch.chdir(self.path.parent)
        assert "ONNX Runtime refuses the file" in refusal(self.path)


def test_a_high_rest_is_subtracted_before_the_network() -> None:
    frames = np.full((5, 8, 8), 90, np.float32)
    low, one, high = np.full((3, 64), 4, np.float32)
    one[10], high[:] = 70, 40
    high[20] = 95
    assert subtract_high_rest(frames, low) is frames
    seen = subtract_high_rest(frames, one)
    assert np.unique(seen).tolist() == [20, 90]
    assert (seen[:, 1, 2] == 20).all()
    assert np.unique(subtract_high_rest(frames, high)).tolist() == [0, 50]
