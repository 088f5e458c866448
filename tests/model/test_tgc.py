"""The network: causal, one for every length, and the same in ONNX Runtime as in PyTorch."""

from pathlib import Path

import msgspec
import numpy as np
import pytest

pytest.importorskip("torch", reason="needs the extra `train`")
pytest.importorskip("onnx", reason="needs the extra `train`")

import torch
from torch import Tensor

from touchd.model.classifier import Classifier, ModelMetadata
from touchd.model.settings import NetworkSettings
from touchd.model.studies.checks.hard_cases import checkerboard, flat, hand
from touchd.model.tgc import TGC, FeatureDropout, _convolve
from touchd.model.training.export import CalibratedTGC, export
from touchd.model.training.stepwise import MEMORY_FRAMES, initial_state, step

pytestmark = [pytest.mark.timeout(300), pytest.mark.usefixtures("one_thread")]

SMALL = NetworkSettings(
    stem_width=4,
    width=16,
    dilations=(1, 2),
    blocks=1,
    heads=2,
    feed_forward=24,
    dense=12,
    smooth_frames=2,
    knee_counts=6.0,
)
LABELS = ("constant", "notouch", "pat", "rub", "scratch", "stroke", "tickle")
TEMPERATURES = {54: 1.5, 81: 1.2, 144: 0.6}
INTERPOLATED = {1: 1.5, 54: 1.5, 63: 1.4, 81: 1.2, 102: 1.0, 144: 0.6, 200: 0.6}
LENGTHS = (1, 2, 17, 54, 60, 143)


def random_network(settings: NetworkSettings = SMALL) -> TGC:
    """A network with all parameters random, so that none is hidden by a zero or a one."""
    torch.manual_seed(0)
    network = TGC(settings, len(LABELS))
    with torch.no_grad():
        for parameter in network.parameters():
            parameter.add_(0.1 * torch.randn_like(parameter))
        network.dense.get_submodule("5").get_parameter("weight").mul_(5.0)
    return network.eval()


def batch(counts: np.ndarray) -> Tensor:
    return torch.from_numpy(counts.astype(np.float64))[None]


@pytest.fixture(scope="module")
def network() -> TGC:
    return random_network().double()


@torch.no_grad()
def test_one_pass_answers_at_every_length(network: TGC) -> None:
    window = batch(hand(144))
    together = network.at_lengths(window, torch.tensor([LENGTHS]))
    for place, length in enumerate(LENGTHS):
        alone = network(window[:, :length])
        assert (together[:, place] - alone).abs().max().item() <= 1e-6


@torch.no_grad()
@pytest.mark.parametrize(
    "later", [flat(0.0, 90), flat(1023.0, 90), checkerboard(90)], ids=["0", "1023", "both"]
)
def test_an_answer_does_not_depend_on_what_comes_later(network: TGC, later: np.ndarray) -> None:
    for length in LENGTHS:
        now = hand(length)
        answer = network.at_lengths(batch(np.concatenate([now, later])), torch.tensor([[length]]))[:, 0]
        assert (answer - network(batch(now))).abs().max().item() <= 1e-6


@torch.no_grad()
def test_an_answer_does_depend_on_every_frame_before(network: TGC) -> None:
    window = batch(hand(30))
    answer = network(window)
    for frame in (0, 13, 29):
        changed = window.clone()
        changed[:, frame] = 500.0
        assert (network(changed) - answer).abs().max().item() > 1e-3


@torch.no_grad()
@pytest.mark.parametrize("settings", [SMALL, msgspec.structs.replace(SMALL, blocks=2)])
def test_frames_a_few_at_a_time_equal_the_window(settings: NetworkSettings) -> None:
    network = random_network(settings).double()
    window = batch(hand(144))
    state, start = initial_state(network), 0
    for size in (1, 1, 2, 50, 1, 7, 60, 22):
        logits, state = step(network, window[:, start : start + size], state)
        start += size
        assert (logits - network(window[:, :start])).abs().max().item() <= 1e-9
    assert start == 144


@pytest.mark.slow
@torch.no_grad()
def test_attention_forgets_only_negligible_frames(monkeypatch: pytest.MonkeyPatch) -> None:
    network, frames = random_network(), batch(checkerboard(6000)).float()
    kept = step(network, frames, initial_state(network))[1]
    assert kept.memory[0].shape[2] == MEMORY_FRAMES < 6000
    monkeypatch.setattr("touchd.model.training.stepwise.MEMORY_FRAMES", 10**6)
    unbounded = step(network, frames, initial_state(network))[1]
    answers = [step(network, batch(hand(1)).float(), state)[0] for state in (kept, unbounded)]
    assert (answers[0] - answers[1]).abs().max().item() <= 1e-6


def test_dropout_drops_whole_features_and_keeps_the_mean() -> None:
    torch.manual_seed(0)
    dropped = FeatureDropout(0.25).train()(torch.ones(500, 7, 40))
    assert dropped.unique().tolist() == pytest.approx([0.0, 1 / 0.75])
    assert torch.equal(dropped.amin(dim=1), dropped.amax(dim=1))
    assert dropped.mean().item() == pytest.approx(1.0, abs=0.02)
    assert torch.equal(FeatureDropout(0.25).eval()(torch.ones(2, 3, 4)), torch.ones(2, 3, 4))


@torch.no_grad()
@pytest.mark.parametrize(
    ("frames", "temperatures", "expected"),
    [
        *((frames, TEMPERATURES, expected) for frames, expected in INTERPOLATED.items()),
        *((frames, {144: 0.8}, 0.8) for frames in (10, 144, 200)),
    ],
)
def test_the_temperature_is_interpolated_between_the_calibrated_lengths(
    frames: int, temperatures: dict[int, float], expected: float
) -> None:
    calibrated = CalibratedTGC(random_network(), temperatures).double().eval()
    window = batch(hand(frames))
    logits, logs = calibrated.network(window)[0], calibrated(window)[0].log()
    # log p is logits / temperature, up to a constant.
    temperature = float((logits[0] - logits[1]) / (logs[0] - logs[1]))
    assert temperature == pytest.approx(expected, abs=1e-5)


def metadata() -> ModelMetadata:
    return msgspec.structs.replace(
        Classifier.load().metadata,
        name="small",
        labels=LABELS,
        lengths=tuple(TEMPERATURES),
        max_length=432,
        temperatures={str(length): value for length, value in TEMPERATURES.items()},
    )


@pytest.fixture(scope="module")
def exported(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("exported") / "folder" / "small.onnx"
    export(random_network(), metadata(), path)
    return path


# An export takes 12 s of processor time; test_adapt.py compares the shipped file with PyTorch.
@pytest.mark.slow
def test_the_exported_file_names_itself_and_no_folder(exported: Path) -> None:
    assert Classifier.load(exported).metadata == metadata()
    assert str(Path(__file__).parents[2]).encode() not in exported.read_bytes()


@pytest.mark.slow
@torch.no_grad()
@pytest.mark.parametrize("frames", [1, 2, 9, 27, 54, 67, 81, 108, 144, 216, 432])
def test_the_exported_file_answers_as_pytorch_does_in_float64(exported: Path, frames: int) -> None:
    calibrated = CalibratedTGC(random_network(), TEMPERATURES).double().eval()
    classifier = Classifier.load(exported)
    for window in (hand(frames), checkerboard(frames), flat(3.0, frames)):
        expected = calibrated(batch(window))[0].numpy()
        assert np.abs(classifier.probabilities(window) - expected).max() <= 1e-4


class OnGpu(Tensor):
    """A tensor that says that it is on a GPU."""

    is_cuda = True


@pytest.mark.parametrize("size", [8, 4])
def test_a_gpu_convolves_by_one_product_with_the_same_result(size: int) -> None:
    images, weight, bias = torch.randn(3, 5, size, size), torch.randn(7, 5, 3, 3), torch.randn(7)
    expected = torch.nn.functional.conv2d(images, weight, bias, padding=1)
    product = _convolve(images.as_subclass(OnGpu), weight, bias)
    assert isinstance(product, OnGpu)
    torch.testing.assert_close(product.as_subclass(Tensor), expected, atol=1e-4, rtol=1e-4)
