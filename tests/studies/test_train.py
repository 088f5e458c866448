"""Training: reproducible by seed, resumable to the same weights; checkpoints carry their origin."""

import itertools
import os
import zipfile
from importlib import metadata
from pathlib import Path

import msgspec
import numpy as np
import pytest

pytest.importorskip("torch", reason="needs the extra `train`")

import torch

from touchd.drivers.recording import Recording, ideal_clock_ms
from touchd.model.adapt.origin import code_version, data_hash
from touchd.model.adapt.schedule import learning_rate_at
from touchd.model.settings import NetworkSettings
from touchd.model.training import checkpoint
from touchd.model.training.checkpoint import Checkpoint, CheckpointError, save
from touchd.model.training.recipe import SHIPPED_RECIPE, final_jobs, fold_jobs, read_recipe
from touchd.model.training.settings import TrainSettings
from touchd.model.training.studies import study_of
from touchd.model.training.train import CHECKPOINT_NAME, Training, train

pytestmark = pytest.mark.usefixtures("one_thread")
NETWORK = NetworkSettings(
    stem_width=2, width=8, dilations=(1,), blocks=1, heads=2, feed_forward=8, dense=8, dropout=0.1
)
SETTINGS = TrainSettings(
    name="tiny",
    seed=3,
    epochs=3,
    crops_per_recording=2,
    batch=4,
    window=12,
    lengths=(4, 12),
    learning_rate=1e-2,
    network=NETWORK,
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


@pytest.fixture(scope="module")
def finished(tmp_path_factory: pytest.TempPathFactory) -> tuple[Checkpoint, Path]:
    folder = tmp_path_factory.mktemp("finished")
    return train(recordings(), SETTINGS, folder, DEVICE), folder / CHECKPOINT_NAME


def test_only_the_same_seed_gives_the_same_network(finished: tuple[Checkpoint, Path], tmp_path: Path) -> None:
    assert same(train(recordings(), SETTINGS, tmp_path / "same", DEVICE), finished[0])
    other = msgspec.structs.replace(SETTINGS, seed=4)
    assert not same(train(recordings(), other, tmp_path / "other", DEVICE), finished[0])


def test_a_training_begins_with_the_weights_that_it_names(
    finished: tuple[Checkpoint, Path], tmp_path: Path
) -> None:
    save(finished[0], tmp_path / "first" / CHECKPOINT_NAME)
    still = msgspec.structs.replace(SETTINGS, learning_rate=0.0, weight_decay=0.0, begins_from="first")
    assert same(train(recordings(), still, tmp_path / "second", DEVICE), finished[0])


def test_the_kept_network_holds_a_share_of_the_weights_that_it_begins_with(
    finished: tuple[Checkpoint, Path], tmp_path: Path
) -> None:
    save(finished[0], tmp_path / "first" / CHECKPOINT_NAME)

    def kept(share: float, epochs_before: int = 0) -> Checkpoint:
        settings = msgspec.structs.replace(SETTINGS, begins_from="first", begins_share=share)
        folder = tmp_path / f"{share}-{epochs_before}"
        if epochs_before:
            interrupted = Training(recordings(), settings, DEVICE)
            interrupted.begin_with(finished[0])
            interrupted.run_epoch()
            save(interrupted.snapshot(), folder / CHECKPOINT_NAME)
        return train(recordings(), settings, folder, DEVICE)

    none, half = kept(0.0), kept(0.5)
    assert not same(none, finished[0])
    for name, weights in half.network.items():
        torch.testing.assert_close(weights, (none.network[name] + finished[0].network[name]) / 2)
    assert same(kept(0.5, epochs_before=1), half)


def test_a_first_stage_that_saw_held_out_people_is_refused(
    finished: tuple[Checkpoint, Path], tmp_path: Path
) -> None:
    save(finished[0], tmp_path / "first" / CHECKPOINT_NAME)
    second = msgspec.structs.replace(SETTINGS, left_out=("P5", "S03"), begins_from="first")
    with pytest.raises(CheckpointError, match=r"may have learnt from P5$"):
        train(recordings(), second, tmp_path / "second", DEVICE)


def test_each_stage_holds_out_the_same_people() -> None:
    names = ("touchd-3.yaml", "touchd-4.yaml", SHIPPED_RECIPE.name)
    stages = [read_recipe(SHIPPED_RECIPE.with_name(name)) for name in names]
    for first, second in itertools.pairwise(stages):
        jobs = (*final_jobs(first)[:1], *fold_jobs(first))
        assert list(second.begins_from) == [job.name for job in jobs]
        studies = first.settings.studies
        for fold, earlier in zip(second.folds, first.folds, strict=True):
            assert {name for name in fold if study_of(name) in studies} == {*earlier}


def test_a_study_without_tickle_does_not_teach_against_it() -> None:
    training = Training([*recordings(), *recordings(("S03",))], SETTINGS, DEVICE)
    training.labels = ("notouch", "rub", "tickle")
    targets = torch.tensor([[0.0, 1.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.5, 0.5]])
    soft = torch.tensor([True, False, True])
    assert training._possible(targets, soft)[:, 2].tolist() == [False, True, True]


def test_studies_are_drawn_equally_often() -> None:
    people = (*(f"P{i}" for i in range(3, 9)), "S03", "S04")
    training = Training(recordings(people), msgspec.structs.replace(SETTINGS, balance_people=True), DEVICE)
    drawn = [training.participants[i][0] for _ in range(40) for i in training._order().tolist()]
    assert 0.45 < drawn.count("S") / len(drawn) < 0.55


def test_the_rate_may_end_above_zero() -> None:
    training = Training(recordings(), msgspec.structs.replace(SETTINGS, rate_epochs=6), DEVICE)
    while training.epoch < SETTINGS.epochs:
        training.run_epoch()
    (group,) = training.optimizer.param_groups
    steps = SETTINGS.epochs * training.steps_per_epoch
    assert group["lr"] == learning_rate_at(steps - 1, 2 * steps, SETTINGS.learning_rate)
    assert group["lr"] > 0.4 * SETTINGS.learning_rate


def test_the_network_averages_the_saved_epochs(tmp_path: Path) -> None:
    training = Training(recordings(), msgspec.structs.replace(SETTINGS, averaged_epochs=(2, 3)), DEVICE)
    training.run_epoch()
    training.run_epoch()
    save(training.snapshot(), tmp_path / CHECKPOINT_NAME)
    second = {name: value.clone() for name, value in training.average.state_dict().items()}
    resumed = Training(recordings(), training.settings, DEVICE)
    resumed.resume(checkpoint.load(tmp_path / CHECKPOINT_NAME))
    resumed.run_epoch()
    third = resumed.average.state_dict()
    for name, value in resumed.snapshot().network.items():
        torch.testing.assert_close(value, (second[name] + third[name]) / 2)


@pytest.mark.slow
@pytest.mark.timeout(600)
def test_a_compiled_step_learns_the_same(tmp_path: Path) -> None:
    # Compiled dropout draws other numbers.
    plain = msgspec.structs.replace(SETTINGS, network=msgspec.structs.replace(NETWORK, dropout=0.0))
    expected = train(recordings(), plain, tmp_path / "plain", DEVICE)
    compiled = train(recordings(), msgspec.structs.replace(plain, compiled=True), tmp_path / "fast", DEVICE)
    for name, value in expected.network.items():
        torch.testing.assert_close(compiled.network[name], value, atol=2e-3, rtol=0.0)


def test_a_checkpoint_with_a_removed_setting_is_readable(
    finished: tuple[Checkpoint, Path], tmp_path: Path
) -> None:
    stored = torch.load(finished[1], weights_only=True)
    stored["settings"] = stored["settings"].replace('{"name"', '{"gone":[1],"name"', 1)
    torch.save(stored, tmp_path / CHECKPOINT_NAME)
    assert checkpoint.load(tmp_path / CHECKPOINT_NAME).settings == SETTINGS


@pytest.mark.parametrize(
    ("instruction", "dtype"),
    [("avx512_bf16", torch.bfloat16), ("amx_bf16", torch.bfloat16), ("avx2", torch.float32)],
)
def test_bfloat16_is_used_only_where_the_processor_has_it(
    instruction: str, dtype: torch.dtype, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("torch.cpu.get_capabilities", lambda: {instruction: True}, raising=False)
    training = Training(recordings(), msgspec.structs.replace(SETTINGS, bfloat16=True), "cpu")
    seen: set[torch.dtype] = set()
    training.network.stem.embed.register_forward_hook(lambda *given: seen.add(given[2].dtype))
    training.run_epoch()
    assert seen == {dtype}


@pytest.mark.parametrize("epochs_before", [1, 2])
def test_an_interrupted_training_ends_in_the_same_network(
    finished: tuple[Checkpoint, Path], tmp_path: Path, epochs_before: int
) -> None:
    interrupted = Training(recordings(), SETTINGS, DEVICE)
    for _ in range(epochs_before):
        interrupted.run_epoch()
    save(interrupted.snapshot(), tmp_path / CHECKPOINT_NAME)
    torch.manual_seed(99)
    torch.rand(5)
    resumed = train(recordings(), SETTINGS, tmp_path, DEVICE)
    assert resumed.epoch == SETTINGS.epochs
    assert same(resumed, finished[0])


def test_a_finished_training_is_not_trained_on(finished: tuple[Checkpoint, Path]) -> None:
    done, path = finished
    before = path.stat().st_mtime_ns
    assert same(train(recordings(), SETTINGS, path.parent, DEVICE), done)
    assert path.stat().st_mtime_ns == before


def test_two_plainly_different_gestures_are_learnt(tmp_path: Path) -> None:
    longer = msgspec.structs.replace(SETTINGS, epochs=16, average_decay=0.8)
    network = train(recordings(), longer, tmp_path, DEVICE).build()
    unseen = recordings(("P9",), seed=7)
    with torch.no_grad():
        answers = [network(torch.from_numpy(each.counts.astype(np.float32))[None]) for each in unseen]
    assert [int(answer.argmax()) for answer in answers] == [0, 1]


def test_a_checkpoint_carries_its_origin(finished: tuple[Checkpoint, Path]) -> None:
    saved = checkpoint.load(finished[1])
    assert saved.settings == SETTINGS
    assert saved.labels == ("notouch", "rub")
    assert saved.epoch == SETTINGS.epochs
    assert saved.data_sha256 == data_hash(recordings())
    assert saved.code_version != code_version()
    assert saved.code_version.startswith(f"{metadata.version('touchd')}+")


def test_a_checkpoint_holds_the_averaged_network(finished: tuple[Checkpoint, Path]) -> None:
    saved = checkpoint.load(finished[1])
    assert same(saved, finished[0])
    raw = saved.training["network"]
    assert any(not torch.equal(raw[name], saved.network[name]) for name in raw)
    assert not saved.build().training


@pytest.mark.parametrize(
    ("settings", "data"),
    [
        (msgspec.structs.replace(SETTINGS, learning_rate=2e-3), recordings()),
        (msgspec.structs.replace(SETTINGS, epochs=4), recordings()),
        (SETTINGS, recordings(seed=1)),
    ],
    ids=["other rate", "other epochs", "other data"],
)
def test_the_folder_of_another_training_is_refused(
    finished: tuple[Checkpoint, Path], settings: TrainSettings, data: list[Recording]
) -> None:
    before = finished[1].read_bytes()
    with pytest.raises(CheckpointError, match="made with other settings or data; choose another folder"):
        train(data, settings, finished[1].parent, DEVICE)
    assert finished[1].read_bytes() == before


@pytest.mark.parametrize("content", [b"", b"not a checkpoint", b"PK\x03\x04" + bytes(100)])
def test_a_damaged_checkpoint_is_refused_in_one_line(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / CHECKPOINT_NAME
    path.write_bytes(content)
    with pytest.raises(CheckpointError) as raised:
        checkpoint.load(path)
    assert str(raised.value).startswith(f"{path}: not a checkpoint of touchd")
    assert "\n" not in str(raised.value)


def test_a_missing_checkpoint_says_how_to_make_one(tmp_path: Path) -> None:
    with pytest.raises(CheckpointError, match="there is no checkpoint; make one with"):
        checkpoint.load(tmp_path / CHECKPOINT_NAME)


def test_the_learning_rate_warms_up_and_decays() -> None:
    rates = [learning_rate_at(step, 100, 1.0) for step in range(100)]
    assert rates[:10] == sorted(rates[:10])
    assert max(rates) == rates[9] == rates[10] == 1.0
    assert rates[10:] == sorted(rates[10:], reverse=True)
    assert rates[-1] < 0.001


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
