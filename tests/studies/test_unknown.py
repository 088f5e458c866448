"""Touches made for training: what is none of the gestures, slow caresses, and how they are drawn."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import msgspec
import numpy as np
import pytest

pytest.importorskip("torch", reason="needs the extra `train`")

import itertools

import torch

from touchd.drivers.frame import MAX_COUNT, OTHER
from touchd.drivers.recording import Recording
from touchd.model.classifier import SHIPPED_MODEL, Classifier
from touchd.model.settings import NetworkSettings
from touchd.model.studies.simulated import simulate
from touchd.model.tgc import TGC
from touchd.model.training import caress, checkpoint, unknown
from touchd.model.training.calibrate import fit_shift, shifted
from touchd.model.training.checkpoint import Checkpoint
from touchd.model.training.haart import GESTURES, LABELS
from touchd.model.training.recipe import Job
from touchd.model.training.refine import extended, refine
from touchd.model.training.settings import Refinement, TrainSettings
from touchd.model.training.touches import TouchSampler
from touchd.model.training.train import CHECKPOINT_NAME

pytestmark = pytest.mark.usefixtures("one_thread")
T = 144
NETWORK = NetworkSettings(
    stem_width=2, width=8, dilations=(1,), blocks=1, heads=2, feed_forward=8, dense=8, dropout=0.1
)
OWN = TrainSettings(
    name="tiny",
    studies=("haart", "third"),
    steps=3,
    batch=8,
    lengths=(9, 54, 144),
    passing=0.5,
    refined=Refinement(windows=32),
    network=NETWORK,
)


def known(gestures: tuple[str, ...] = GESTURES) -> list[Recording]:
    """Return a recording of each gesture by one person on a fabric pad and one on the third study's."""
    made = simulate([(gesture, 4.0) for gesture in gestures], 3)
    return [replace(each, participant=person) for person in ("P3", "S01") for each in made]


def strange() -> list[Recording]:
    return [replace(each, gesture=OTHER, participant="S01") for each in simulate([("tickle", 4.0)], 5)]


@pytest.mark.parametrize("maker", unknown.MAKERS, ids=lambda maker: maker.__name__)
def test_every_made_touch_presses_from_its_first_frames(maker: unknown.Maker) -> None:
    for seed in range(20):
        made = maker(np.random.default_rng(seed), T)
        assert made.shape == (T, 8, 8)
        assert np.isfinite(made).all()
        assert made[:12].max() > 3.0


def test_a_blow_is_over_in_an_instant() -> None:
    blows = [unknown.blow(np.random.default_rng(seed), T) for seed in range(30)]
    pressed = [(blow.max(axis=(1, 2)) > 5.0).sum() for blow in blows]
    assert np.median(pressed) <= 15
    assert max(blow.max() for blow in blows) <= MAX_COUNT


@pytest.mark.parametrize("make", [caress.made, lambda rng: caress.slowed(rng, one_way(rng))])
def test_a_slow_caress_goes_one_way(make: Callable[[np.random.Generator], unknown.Floats]) -> None:
    for seed in range(10):
        made = make(np.random.default_rng(seed))
        assert 20 <= len(made) <= caress.MOST_FRAMES
        parts = [part.sum(axis=0) for part in np.array_split(made, 5)]
        places = [np.array([(part * unknown.ROW).sum(), (part * unknown.COLUMN).sum()]) / part.sum()
                  for part in parts]  # fmt: skip
        way = places[-1] - places[0]
        steps = [float((later - earlier) @ way) for earlier, later in itertools.pairwise(places)]
        assert min(steps) > -0.1 * float(way @ way)


def one_way(rng: np.random.Generator) -> unknown.Floats:
    """Return a stroke as one is recorded."""
    places = np.linspace(1.0, 6.0, 40)
    return 60.0 * unknown.spot(places, np.full(40, 3.5), 1.2, 1.4)


def test_the_same_share_is_unknown_on_every_pad() -> None:
    torch.manual_seed(0)
    sampler = TouchSampler([*known(), *strange()], LABELS, OWN)
    drawn = [sampler.draw(64) for _ in range(6)]
    is_other = torch.cat([each.targets[:, -1, -1] > 0.5 for each in drawn])
    assert OWN.refined is not None
    assert float(is_other.float().mean()) == pytest.approx(OWN.refined.unknown, abs=0.05)
    # Only the third study's pad has windows without tickle.
    soft = torch.cat([~each.possible[:, GESTURES.index("tickle")] for each in drawn])
    assert 0.1 < float(soft.float().mean()) < 0.6


def test_an_unknown_touch_is_never_tickle_on_any_pad() -> None:
    torch.manual_seed(1)
    drawn = TouchSampler([*known(), *strange()], LABELS, OWN).draw(128)
    assert drawn.possible[drawn.unknown == 1.0].all()


def test_refining_moves_only_the_upper_layers(tmp_path: Path) -> None:
    torch.manual_seed(0)
    network = TGC(NETWORK, len(GESTURES))
    first = Checkpoint(OWN, GESTURES, 0, dict(network.state_dict()), {}, "code", "data")
    saved = refine([*known(), *strange()], Job("job", OWN), first, tmp_path)
    assert saved.labels == LABELS
    for name, weights in first.network.items():
        is_lower = name.startswith(("stem", "motion"))
        same = saved.network[name].shape == weights.shape and torch.equal(saved.network[name], weights)
        assert same == is_lower, name
    again = checkpoint.load(tmp_path / "job" / CHECKPOINT_NAME)
    assert all(torch.equal(again.network[name], weights) for name, weights in saved.network.items())


def test_steadied_networks_answer_more_like_the_first_one(tmp_path: Path) -> None:
    torch.manual_seed(0)
    first = Checkpoint(OWN, GESTURES, 0, dict(TGC(NETWORK, 7).state_dict()), {}, "code", "data")
    windows = torch.from_numpy(np.stack([each.counts[:T] for each in known()]).astype(np.float32))

    def change(steady: float) -> float:
        own = msgspec.structs.replace(
            OWN, steps=8, learning_rate=0.01, refined=msgspec.structs.replace(OWN.refined, steady=steady)
        )
        saved = refine([*known(), *strange()], Job(f"steady {steady}", own), first, tmp_path)
        with torch.no_grad():
            wanted, moved = (torch.softmax(each.build()(windows)[:, :7], 1) for each in (first, saved))
        return float((wanted - moved).abs().mean())

    assert change(20.0) < 0.5 * change(0.0)


def test_a_new_answer_begins_unlikely() -> None:
    first = Checkpoint(OWN, GESTURES, 0, dict(TGC(NETWORK, 7).state_dict()), {}, "code", "data")
    windows = torch.from_numpy(np.stack([each.counts[:T] for each in known()]).astype(np.float32))
    with torch.no_grad():
        before = first.build()(windows)
        after = extended(first, LABELS).eval()(windows)
    assert torch.allclose(before, after[:, :7], atol=1e-6)
    assert (after[:, 7] < after[:, :7].amax(dim=1)).all()


def test_a_model_file_restores_its_network() -> None:
    saved = checkpoint.restored(SHIPPED_MODEL)
    model = Classifier.load()
    counts = np.stack([each.counts[:T] for each in known()[:4]]).astype(np.float32)
    with torch.no_grad():
        logits = saved.build()(torch.from_numpy(counts)) / model.metadata.temperatures["144"]
    assert torch.softmax(logits, dim=-1).numpy() == pytest.approx(model.batch_probabilities(counts), abs=1e-5)


def test_the_shift_keeps_the_share_that_may_be_lost() -> None:
    rng = np.random.default_rng(0)
    truth = rng.integers(7, size=4000)
    logits = rng.normal(size=(4000, 8))
    answers = dict.fromkeys((54, 81, 144), (logits, truth))
    shift = fit_shift([[answers]], LABELS, [0.02])
    moved = shifted(answers, LABELS, shift)[54][0]
    touched = truth != GESTURES.index("notouch")
    assert (moved[touched].argmax(axis=1) == 7).mean() == pytest.approx(0.02, abs=0.002)
