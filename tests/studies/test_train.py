"""Training: reproducible by seed, resumable to the same weights; checkpoints carry their origin."""

import os
import zipfile
from collections.abc import Callable
from dataclasses import replace
from importlib import metadata
from pathlib import Path

import msgspec
import numpy as np
import pytest

pytest.importorskip("torch", reason="needs the extra `train`")

import torch
from torch import nn

from touchd.drivers.recording import Recording, ideal_clock_ms
from touchd.model.adapt.adapt import code_version, data_hash
from touchd.model.classifier import SHIPPED_MODEL
from touchd.model.settings import NetworkSettings
from touchd.model.tgc import TGC
from touchd.model.training import checkpoint
from touchd.model.training.checkpoint import Checkpoint, CheckpointError, save
from touchd.model.training.recipe import Job, Recipe, all_jobs, read_recipe, study_jobs
from touchd.model.training.settings import Shares, Study, TrainSettings
from touchd.model.training.ship import finished as finished_training
from touchd.model.training.ship import train_recipe
from touchd.model.training.studies import Folders, study_of
from touchd.model.training.train import (
    CHECKPOINT_NAME,
    Ask,
    AtLengths,
    Training,
    sequential,
    train,
    vectorized,
)
from touchd.model.training.weights import HAART_MODEL
from touchd.model.training.windows import WindowSampler

pytestmark = pytest.mark.usefixtures("one_thread")
NETWORK = NetworkSettings(
    stem_width=2, width=8, dilations=(1,), blocks=1, heads=2, feed_forward=8, dense=8, dropout=0.1
)
SETTINGS = TrainSettings(
    name="tiny", seed=3, steps=12, batch=4, window=12, lengths=(4, 12), learning_rate=1e-2, network=NETWORK
)
# Torch is deterministic within one machine only: equality is checked within one run.
DEVICE = "cpu"


def recordings(participants: tuple[str, ...] = ("P3", "P4"), seed: int = 0) -> list[Recording]:
    """Return made-up recordings of a still pad and a busy one."""
    rng = np.random.default_rng(seed)
    made: list[Recording] = []
    for participant in participants:
        for gesture, most in (("notouch", 4), ("rub", 400)):
            counts = rng.integers(most, size=(40, 8, 8)).astype(np.uint16)
            clock = ideal_clock_ms(len(counts))
            made.append(Recording(participant, "foam", "fur", gesture, counts, clock, "live"))
    return made


def same(one: Checkpoint, other: Checkpoint) -> bool:
    return all(torch.equal(one.network[name], other.network[name]) for name in one.network)


def trained(settings: TrainSettings, runs: Path, data: list[Recording] | None = None) -> Checkpoint:
    (network,) = train(data or recordings(), [Job("tiny", settings)], runs, DEVICE)
    return network


def another(**changed: object) -> TrainSettings:
    return msgspec.structs.replace(SETTINGS, **changed)


@pytest.fixture(scope="module")
def finished(tmp_path_factory: pytest.TempPathFactory) -> tuple[Checkpoint, Path]:
    runs = tmp_path_factory.mktemp("finished")
    return trained(SETTINGS, runs), runs / "tiny" / CHECKPOINT_NAME


def test_only_the_same_seed_gives_the_same_network(finished: tuple[Checkpoint, Path], tmp_path: Path) -> None:
    done, path = finished
    before = path.stat().st_mtime_ns
    # A training that has ended is not continued.
    assert same(trained(SETTINGS, path.parents[1]), done)
    assert path.stat().st_mtime_ns == before
    assert same(trained(SETTINGS, tmp_path / "same"), finished[0])
    assert not same(trained(another(seed=4), tmp_path / "other"), finished[0])


PEOPLE = ("P3", "P4", "S03")
CALM = msgspec.structs.replace(NETWORK, dropout=0.0)
SIDE_BY_SIDE = [
    another(studies=("haart", "third"), left_out=("P4",)),
    another(studies=("haart", "third"), seed=4),
    another(studies=("haart",)),
]


def test_each_of_several_networks_learns_from_its_own_people() -> None:
    data = recordings(PEOPLE)
    training = Training(data, SIDE_BY_SIDE, DEVICE)
    places = torch.rand(3, 500)
    places[:, 0] = 1.0 - 2**-24
    chosen = torch.searchsorted(training.sampler.drawn, places, right=True)
    drawn = [{data[i].participant for i in own.tolist()} for own in chosen]
    assert drawn == [{"P3", "S03"}, {"P3", "P4", "S03"}, {"P3", "P4"}]


@pytest.mark.parametrize("way", [vectorized, sequential])
def test_networks_trained_in_parallel_answer_as_trained_alone(way: Callable[[nn.Module], Ask]) -> None:
    still = [msgspec.structs.replace(each, network=CALM) for each in SIDE_BY_SIDE]
    training = Training(recordings(PEOPLE), still, DEVICE)
    windows = torch.rand(3, 2, 12, 8, 8) * 100.0
    lengths = torch.tensor(SETTINGS.lengths).expand(3, 2, -1)
    together = way(AtLengths(TGC(CALM, 2)))(training.weights, windows, lengths)
    for network, own, answers in zip(training.snapshots(), windows, together, strict=True):
        torch.testing.assert_close(network.build().at_lengths(own, torch.tensor([SETTINGS.lengths])), answers)


def test_the_recipe_holds_out_each_person_and_the_third_study() -> None:
    recipe = read_recipe()
    people = [name for fold in recipe.folds for name in fold]
    assert len(people) == len({*people}) == 33
    assert all({study_of(name) for name in fold} == {*recipe.settings.studies} for fold in recipe.folds)
    (pad,) = study_jobs(recipe)
    assert pad.settings.studies == ("haart", "second")
    assert len({job.name for job in all_jobs(recipe)}) == len(recipe.seeds) + len(recipe.folds) + 1


def test_a_study_without_tickle_does_not_teach_against_it() -> None:
    sampler = WindowSampler(recordings(("P3", "S03")), [another(studies=("haart", "third"))], DEVICE)
    sampler.missing = torch.tensor([False, False, True])
    targets = torch.tensor([[[0.0, 1.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.5, 0.5]]])
    soft = torch.tensor([[True, False, True]])
    assert sampler.possible(targets, soft)[0, :, 2].tolist() == [False, True, True]


@pytest.mark.parametrize(("third", "expected"), [(1.0, 0.5), (0.5, 1 / 3)])
def test_studies_are_drawn_by_their_shares(third: float, expected: float) -> None:
    people = (*(f"P{i}" for i in range(3, 9)), "S03", "S04")
    shared = another(shares=Shares(third=third), studies=("haart", "third"))
    data = recordings(people)
    (drawn,) = WindowSampler(data, [shared], DEVICE).drawn
    chosen = torch.searchsorted(drawn, torch.rand(4000), right=True).tolist()
    share = sum(data[i].participant[0] == "S" for i in chosen) / 4000
    assert share == pytest.approx(expected, abs=0.05)


@pytest.mark.parametrize("steps_before", [1, pytest.param(5, marks=pytest.mark.slow)])
def test_interrupted_trainings_end_in_the_same_networks(tmp_path: Path, steps_before: int) -> None:
    data = recordings(PEOPLE)
    jobs = [Job(f"network{i}", each) for i, each in enumerate(SIDE_BY_SIDE)]
    expected = train(data, jobs, tmp_path / "whole", DEVICE)
    interrupted = Training(data, SIDE_BY_SIDE, DEVICE)
    interrupted.run(steps_before)
    for job, snapshot in zip(jobs, interrupted.snapshots(), strict=True):
        save(snapshot, tmp_path / "cut" / job.name / CHECKPOINT_NAME)
    torch.manual_seed(99)
    torch.rand(5)
    for resumed, whole in zip(train(data, jobs, tmp_path / "cut", DEVICE), expected, strict=True):
        assert resumed.step == SETTINGS.steps
        assert same(resumed, whole)


class MadeUp(Folders):
    """Folders of all studies with made-up recordings."""

    def to_train_on(self, studies: tuple[Study, ...]) -> list[Recording]:
        return [
            each for each in recordings(("P3", "P4", "R02", "S03")) if study_of(each.participant) in studies
        ]


RECIPE = Recipe(
    name="tiny",
    folds=(("P3",), ("P4",)),
    seeds=(3, 4),
    left_out_study="third",
    settings=another(studies=("haart", "second", "third")),
)


@pytest.fixture(scope="module")
def runs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of a recipe's trained networks."""
    folder = tmp_path_factory.mktemp("runs")
    train_recipe(RECIPE, MadeUp(folder), folder, threads=1)
    return folder


def test_a_recipe_trains_each_of_its_networks_once(runs: Path) -> None:
    folders = MadeUp(runs)
    networks = [finished_training(job, runs) for job in all_jobs(RECIPE)]
    assert [each.settings.left_out for each in networks] == [(), (), ("P3",), ("P4",), ()]
    assert networks[-1].settings.studies == ("haart", "second")
    times = {path: path.stat().st_mtime_ns for path in runs.rglob(CHECKPOINT_NAME)}
    train_recipe(RECIPE, folders, runs, threads=1)
    assert {path: path.stat().st_mtime_ns for path in times} == times
    changed = msgspec.structs.replace(
        RECIPE, seeds=(7, *RECIPE.seeds), settings=another(weight_decay=0.5, studies=("haart",))
    )
    with pytest.raises(CheckpointError, match="made with other settings than the recipe's"):
        train_recipe(changed, folders, runs, threads=1)
    with pytest.raises(CheckpointError, match="made with other settings than the recipe's"):
        finished_training(all_jobs(changed)[1], runs)


def test_a_recipe_may_begin_from_the_networks_of_another(runs: Path) -> None:
    further = msgspec.structs.replace(
        RECIPE, name="further", begins_from="tiny", settings=another(learning_rate=0.0)
    )
    (job, *_) = all_jobs(further)
    data = MadeUp(runs).to_train_on(job.settings.studies)
    (begun,) = train(data, [job], runs, DEVICE)
    first = finished_training(all_jobs(RECIPE)[0], runs)
    assert same(begun, first)
    kept = replace(job, name="kept", settings=another(studies=job.settings.studies), keeps=0.25)
    (moved,) = train(data, [kept], runs, DEVICE)
    for name, weights in finished_training(kept, runs).network.items():
        expected = 0.75 * moved.network[name] + 0.25 * first.network[name]
        torch.testing.assert_close(weights, expected)
    with pytest.raises(CheckpointError, match="there is no checkpoint"):
        train(data, [replace(job, name="lost", begins_from="nowhere")], runs, DEVICE)


def test_a_training_of_another_device_is_refused_in_one_line(
    finished: tuple[Checkpoint, Path], tmp_path: Path
) -> None:
    elsewhere = replace(
        finished[0], training={**finished[0].training, "rng": torch.zeros(16, dtype=torch.uint8)}
    )
    save(elsewhere, tmp_path / "tiny" / CHECKPOINT_NAME)
    with pytest.raises(CheckpointError, match="cannot go on on this device"):
        trained(SETTINGS, tmp_path)


@pytest.mark.parametrize("path", [SHIPPED_MODEL.with_suffix(".pt"), HAART_MODEL.with_suffix(".pt")], ids=str)
def test_every_shipped_checkpoint_is_readable(path: Path) -> None:
    assert checkpoint.load(path).build()


def test_a_network_whose_training_has_not_ended_is_not_shipped(tmp_path: Path) -> None:
    (job, *_) = all_jobs(RECIPE)
    training = Training(MadeUp(tmp_path).to_train_on(job.settings.studies), [job.settings], DEVICE)
    training.run(5)
    save(training.snapshots()[0], tmp_path / job.name / CHECKPOINT_NAME)
    with pytest.raises(CheckpointError, match="stopped after step 5; run `train` again"):
        finished_training(job, tmp_path)


def test_two_plainly_different_gestures_are_learnt(tmp_path: Path) -> None:
    network = trained(another(steps=60, average_decay=0.8), tmp_path).build()
    unseen = recordings(("P9",), seed=7)
    with torch.no_grad():
        answers = [network(torch.from_numpy(each.counts.astype(np.float32))[None]) for each in unseen]
    assert [int(answer.argmax()) for answer in answers] == [0, 1]


def test_a_checkpoint_carries_its_origin(finished: tuple[Checkpoint, Path]) -> None:
    saved = checkpoint.load(finished[1])
    assert same(saved, finished[0])
    assert saved.settings == SETTINGS
    assert saved.labels == ("notouch", "rub")
    assert saved.step == SETTINGS.steps
    assert saved.data_sha256 == data_hash(recordings())
    assert saved.code_version != code_version()
    assert saved.code_version.startswith(f"{metadata.version('touchd')}+")


@pytest.mark.parametrize(
    ("settings", "data"),
    [
        (another(learning_rate=2e-3), recordings()),
        (another(steps=13), recordings()),
        (SETTINGS, recordings(seed=1)),
    ],
    ids=["other rate", "other steps", "other data"],
)
def test_the_folder_of_another_training_is_refused(
    finished: tuple[Checkpoint, Path], settings: TrainSettings, data: list[Recording]
) -> None:
    before = finished[1].read_bytes()
    with pytest.raises(CheckpointError, match="made with other settings or data; choose another folder"):
        trained(settings, finished[1].parents[1], data)
    assert finished[1].read_bytes() == before


@pytest.mark.parametrize("content", [b"", b"not a checkpoint", b"PK\x03\x04" + bytes(100)])
def test_a_damaged_checkpoint_is_refused_in_one_line(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / CHECKPOINT_NAME
    path.write_bytes(content)
    with pytest.raises(CheckpointError) as raised:
        checkpoint.load(path)
    assert str(raised.value).startswith(f"{path}: not a checkpoint of touchd")
    assert "\n" not in str(raised.value)


def test_a_checkpoint_that_holds_a_program_is_refused(tmp_path: Path) -> None:
    ran = tmp_path / "ran"

    class Trap:
        def __reduce__(self) -> tuple[object, ...]:
            return os.mkdir, (str(ran),)

    torch.save({"state": Trap()}, tmp_path / "trap.pt")
    with pytest.raises(Exception, match=r"trap\.pt"):
        checkpoint.load(tmp_path / "trap.pt")
    assert not ran.exists()
    torch.load(tmp_path / "trap.pt", weights_only=False)
    assert ran.exists(), "the trap would not have caught anything"


def test_a_checkpoint_that_unpacks_too_large_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "huge.pt"
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED, compresslevel=1) as archive:
        with archive.open("archive/data/0", "w", force_zip64=True) as entry:
            for _ in range(checkpoint.MAX_FILE_BYTES // 2**20):
                entry.write(bytes(2**20))
        archive.writestr("archive/data.pkl", b"x")
    assert path.stat().st_size < 2**20
    with pytest.raises(CheckpointError, match="larger than 128 MiB"):
        checkpoint.load(path)
