"""Adapting to a lab's own recordings: labels, model file, figures, and clear refusals."""

import hashlib
import io
import json
import sys
from collections.abc import Callable, Iterable, Sequence
from copy import deepcopy
from dataclasses import replace
from pathlib import Path

import msgspec
import numpy as np
import pytest
from msgspec.structs import replace as replace_in
from numpy.typing import NDArray
from rigs.haart_folder import THIRD_STUDY, needs_third_study

pytest.importorskip("torch", reason="needs the extra `train`")

import onnx
import torch

from touchd.daemon.app import cli
from touchd.daemon.app.cli import options_of
from touchd.daemon.app.config import load
from touchd.daemon.commands import teach
from touchd.daemon.path.events import Label, encode
from touchd.drivers.recording import Recording, ideal_clock_ms, write_recordings
from touchd.model.adapt import adapt as adapting
from touchd.model.adapt.adapt import Adapted, Pretrained, adapt, grafted, logits, write
from touchd.model.adapt.backbone import CropFeatures, Remembered, crops, windows
from touchd.model.adapt.folder import ExtraError, model_name, read_all
from touchd.model.adapt.head import AdaptSettings, fit, rebuilt
from touchd.model.adapt.measure import (
    Comparison,
    LeftOut,
    LengthFigures,
    Scored,
    compare,
    mean_interval,
    plan,
)
from touchd.model.adapt.passing import IN_PASSING, InPassing, joined
from touchd.model.adapt.report import is_better, report_lines
from touchd.model.classifier import SHIPPED_MODEL, Classifier, Name
from touchd.model.studies.checks.hard_cases import hand
from touchd.model.studies.checks.reference import Reference
from touchd.model.studies.simulated import simulate
from touchd.model.tgc import TGC
from touchd.model.training.export import CalibratedTGC
from touchd.model.training.remember import save, statistics
from touchd.model.training.studies import Folders

pytestmark = [pytest.mark.timeout(300), pytest.mark.usefixtures("one_thread")]

# The simulated gesture behind each label; "hug" is new to the shipped model.
DONE = {"hug": "constant", "notouch": "notouch", "pat": "pat", "scratch": "scratch", "stroke": "stroke"}
SETTINGS = AdaptSettings(crops=2, steps=20)
# For tests of labels and figures, for which it does not matter what is learnt.
HARDLY = replace_in(SETTINGS, steps=1)
SECONDS = 3.0


def simulated(
    participants: Sequence[str], each: int, gestures: Sequence[str] = tuple(DONE)
) -> list[Recording]:
    """A lab's recordings: each participant does every gesture `each` times."""
    made = []
    for seed, participant in enumerate(participants):
        for number in range(each):
            script = [(DONE.get(gesture, gesture), SECONDS) for gesture in gestures]
            hands = simulate(script, seed=100 * seed + number)
            made += [
                replace(hand, participant=participant, cover=f"cover{number}", gesture=gesture)
                for hand, gesture in zip(hands, gestures, strict=True)
            ]
    return made


def cut(recording: Recording, frames: int) -> Recording:
    return replace(recording, counts=recording.counts[:frames], sensor_ms=recording.sensor_ms[:frames])


def keep(folder: Path, recordings: Sequence[Recording]) -> Path:
    """Write a folder as `touchd record` does, one file per recording."""
    folder.mkdir(exist_ok=True)
    for number, recording in enumerate(recordings):
        write_recordings(folder / f"{number:03}.csv.gz", [recording], {"source": "made for a test"})
    return folder


def words(lines: Iterable[str]) -> str:
    """Return a text without its line breaks."""
    return " ".join(" ".join(lines).split())


@pytest.mark.parametrize("rest_counts", [5, 60])
def test_a_high_rest_is_subtracted_from_recordings(tmp_path: Path, rest_counts: int) -> None:
    made = [
        replace(each, counts=each.counts + np.uint16(rest_counts))
        for each in simulated(("Ann",), 1, ("notouch", "pat"))
    ]
    untouched, touched = read_all(keep(tmp_path / "lab", made), ()).recordings
    is_high = rest_counts > 10
    rest = np.median(made[0].counts, axis=0) if is_high else np.zeros((8, 8))
    assert np.array_equal(touched.counts, np.clip(made[1].counts - rest, 0, None))
    assert (untouched.counts.mean() < 2) == is_high


@pytest.fixture(scope="module")
def pretrained() -> Pretrained:
    return Pretrained.shipped()


@pytest.fixture(scope="module")
def adapted(pretrained: Pretrained) -> Adapted:
    return adapt(pretrained, simulated(("Ann", "Bo"), 2), SETTINGS)


# --- the whole command ---


@pytest.fixture(scope="module")
def trained(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, str]:
    """The file and output of `touchd train --extra` for two people and five gestures, one of them new."""
    home = tmp_path_factory.mktemp("lab")
    lab, output = keep(home / "lab", simulated(("Ann", "Bo"), 2)), home / "lab.onnx"
    with pytest.MonkeyPatch.context() as patch:
        printed: list[str] = []
        patch.setattr("sys.stdout.write", printed.append)
        patch.setattr(adapting, "SETTINGS", SETTINGS)
        assert cli.main(["train", "--extra", str(lab), "--output", str(output)]) == 0
    return output, "".join(printed)


@pytest.fixture
def adapted_file(trained: tuple[Path, str]) -> Path:
    return trained[0]


def test_the_file_names_gestures_and_origin_but_no_person(adapted_file: Path) -> None:
    metadata = Classifier.load(adapted_file).metadata
    # The lab recorded nothing that is none of the gestures; the network keeps knowing it.
    assert metadata.labels == ("hug", "notouch", "other", "pat", "scratch", "stroke")
    assert metadata.name == "lab"
    origin = metadata.training["adapted"]
    assert origin["from_sha256"] == hashlib.sha256(SHIPPED_MODEL.read_bytes()).hexdigest()
    assert (origin["participants"], origin["recordings"]) == (2, 20)
    assert metadata.scores["adapted"]["left_out"] == "participants"
    assert [row["frames"] for row in metadata.scores["adapted"]["lengths"]] == [54, 81, 144]
    content = adapted_file.read_bytes()
    assert b'"Ann"' not in content
    assert str(adapted_file.parent).encode() not in content


@pytest.mark.parametrize("file", ["Labor Müller (2).onnx", "ö.onnx", f"{'long' * 40}.onnx"])
def test_a_file_may_have_any_name(file: str) -> None:
    assert msgspec.convert(model_name(Path(file)), Name)


def test_the_report_shows_each_gesture_within_80_columns(trained: tuple[Path, str]) -> None:
    printed = trained[1].split("\n\nWritten:")[0]
    assert "20 recordings of 5 gestures by 2 participants" in printed
    assert "New to the model: hug" in printed
    assert all(any(line.startswith(gesture) for line in printed.splitlines()) for gesture in DONE)
    assert "Right answers in percent" in printed
    assert "no longer knows constant, rub, tickle" in words(printed.splitlines())
    assert max(map(len, printed.splitlines())) <= 80


def test_touchd_classify_answers_with_the_new_gesture(
    adapted_file: Path, tmp_path: Path, capfdbinary: pytest.CaptureFixture[bytes]
) -> None:
    unseen = tmp_path / "unseen.csv.gz"
    write_recordings(unseen, simulated(("Cy",), 1, ("notouch", "hug", "pat")), {})
    config = tmp_path / "touchd.yaml"
    config.write_text(
        f"model: {adapted_file}\n"
        "scene: {gestures: [hug, pat], actions: [{gestures: [hug], do: [{say: x}]}]}\n"
    )
    assert cli.main(["classify", str(unseen), "-c", str(config)]) == 0
    events = [json.loads(line) for line in capfdbinary.readouterr().out.splitlines()]
    answers = [event for event in events if event["type"] == "prediction"]
    assert set(answers[0]["probabilities"]) == {*DONE, "other"}
    assert answers[0]["model"] == "lab"
    ended = [event["gesture"] for event in events if event["type"] == "touch_ended"]
    assert ended == ["hug", "pat"]


@pytest.mark.parametrize(
    ("extra", "output", "error"),
    [
        ("missing", "new.onnx", "missing: cannot be read"),
        ("lab.onnx", "new.onnx", "lab.onnx: cannot be read (Not a directory)"),
        ("lab", "new.pt", "a model's name ends with .onnx"),
        ("lab", "nowhere/new.onnx", "nothing can be written there"),
        ("lab", "lab.onnx", "is never overwritten"),
        ("lab", "new.onnx", "torch is not installed (extra train)"),
    ],
)
def test_a_wrong_path_is_reported_before_torch_is_loaded(
    adapted_file: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    extra: str,
    output: str,
    error: str,
) -> None:
    monkeypatch.setitem(sys.modules, "torch", None)
    home, before = adapted_file.parent, adapted_file.read_bytes()
    assert cli.main(["train", "--extra", str(home / extra), "--output", str(home / output)]) == 2
    said = capsys.readouterr().err
    assert error in said
    assert ("torch" in error) == said.endswith("# about 1 GB on the disk\n")
    assert adapted_file.read_bytes() == before
    assert sorted(path.name for path in home.iterdir()) == ["lab", "lab.onnx"]


def test_the_printed_settings_use_the_new_model(trained: tuple[Path, str]) -> None:
    output, printed = trained
    config = output.with_name("printed.yaml")
    config.write_text(printed.split("set in touchd.yaml:\n\n")[1])
    settings = load(config)
    config.unlink()
    assert settings.model == str(output)
    assert settings.scene.gestures == ("hug", "pat", "scratch", "stroke")


# --- training ---


def test_the_same_recordings_and_seed_give_the_same_model(adapted: Adapted, adapted_file: Path) -> None:
    metadata = Classifier.load(adapted_file).metadata
    assert metadata.scores["adapted"] == msgspec.to_builtins(adapted.comparison)
    again = grafted(SHIPPED_MODEL, adapted.head, metadata)
    assert again.graph == onnx.load(adapted_file).graph


@torch.no_grad()
def test_the_file_answers_as_the_adapted_network_in_pytorch(
    pretrained: Pretrained, adapted: Adapted, tmp_path: Path
) -> None:
    write(adapted, tmp_path / "lab.onnx")
    classifier = Classifier.load(tmp_path / "lab.onnx")
    network = TGC(pretrained.backbone.settings, len(adapted.labels))
    network.load_state_dict(pretrained.backbone.state_dict(), strict=False)
    network.dense = deepcopy(adapted.head)
    temperatures = {int(length): value for length, value in classifier.metadata.temperatures.items()}
    exact = Reference(CalibratedTGC(network, temperatures).double().eval())
    for frames in (9, 54, 70, 200):
        expected = exact.probabilities(hand(frames))
        assert np.abs(classifier.probabilities(hand(frames)) - expected).max() <= 1e-4
    _, state = classifier.step(hand(200)[:150])
    assert np.abs(classifier.step(hand(200)[150:], state)[0] - expected).max() <= 1e-4


def test_a_gesture_without_recordings_is_not_forgotten(pretrained: Pretrained) -> None:
    """A lab without recordings at rest keeps the shipped model's knowledge of it."""
    resting = simulated(("Ann", "Bo"), 2, ("notouch",))
    adapted = adapt(pretrained, simulated(("Ann",), 2, ("hug", "pat")), SETTINGS)
    assert "notouch" in adapted.labels
    with torch.no_grad():
        answers = adapted.head(windows(pretrained.backbone, resting)[144].values).argmax(dim=1)
    assert {adapted.labels[i] for i in answers.tolist()} == {"notouch"}
    assert any("No recording of notouch" in line for line in report_lines(adapted))


@pytest.mark.slow
@needs_third_study
def test_a_lab_with_a_gesture_of_its_own_keeps_other(pretrained: Pretrained) -> None:
    """Three people record the known gestures and pokes; four others make what is none of them."""
    folders = Folders(Path("none"), third_study=Path(str(THIRD_STUDY)))
    known, others = folders.to_train_on(("third",)), folders.others(("third",))
    taught, unseen = ("S01", "S03", "S04"), ("S06", "S07", "S08", "S10")
    lesson = [cut(each, 324) for each in known if each.participant in taught]
    lesson += [cut(each, 324) for each in others if each.participant in taught and each.gesture == "poke"]
    adapted = adapt(pretrained, lesson, AdaptSettings(), keep_all=True)
    made = [cut(each, 288) for each in others if each.participant in unseen]
    evaluated = windows(pretrained.backbone, made)[144]
    is_poke = np.array([made[i].gesture == "poke" for i in evaluated.recordings])

    def named(head: torch.nn.Sequential, labels: Sequence[str], gesture: str) -> NDArray[np.bool_]:
        return np.array(logits(head, evaluated).argmax(axis=1) == labels.index(gesture))

    before = named(pretrained.head, pretrained.labels, "other")[~is_poke].mean()
    after = named(adapted.head, adapted.labels, "other")[~is_poke].mean()
    assert after > 0.75 * before
    assert named(adapted.head, adapted.labels, "poke")[is_poke].mean() > 0.5


def test_all_known_gestures_can_be_kept(pretrained: Pretrained) -> None:
    adapted = adapt(pretrained, simulated(("Ann",), 1), HARDLY, keep_all=True)
    assert adapted.labels == tuple(sorted({"hug", *pretrained.labels}))
    said = "No recording of constant, rub, tickle: known from other people and pads only."
    assert said in words(report_lines(adapted))


def test_rehearsal_keeps_others_from_being_forgotten(pretrained: Pretrained) -> None:
    labels = sorted({"hug", *pretrained.labels})
    begin = rebuilt(pretrained.head, pretrained.labels, labels)
    remembered = pretrained.remembered.samples(labels, seed=0)
    shown = crops(pretrained.backbone, simulated(("Ann", "Bo"), 2), pretrained.augmentation, 2, 0)

    def right(rehearsed: float) -> float:
        settings = replace_in(SETTINGS, rehearsed=rehearsed)
        head = fit(begin, labels, ["hug"], shown, remembered, settings)
        others = pretrained.remembered.samples(pretrained.labels, seed=1)
        truth = torch.tensor([labels.index(gesture) for gesture in others.gestures])
        with torch.no_grad():
            return float((head(others.values[:, :, -1]).argmax(dim=-1) == truth[:, None]).float().mean())

    assert right(0.5) > right(0.04) + 0.02


def test_remembered_samples_have_the_moments_of_the_originals(tmp_path: Path) -> None:
    rng = torch.Generator().manual_seed(0)
    along = torch.randn(50, 8, 4, 2, generator=rng)
    seen = 3.0 + along @ torch.tensor([[2.0, 0.0, 1.0], [0.0, 0.5, 0.0]])
    study = CropFeatures(seen, torch.ones(50, 4, dtype=torch.bool), ("hug",) * 50)
    save(statistics([study]), tmp_path / "remembered.npz")
    again = Remembered.load(tmp_path / "remembered.npz").samples({"hug"}, seed=0)
    assert again.gestures == ("hug",)
    drawn = again.values[0].flatten(0, 1)
    torch.testing.assert_close(drawn.mean(dim=0), torch.full((3,), 3.0), atol=0.3, rtol=0.0)
    torch.testing.assert_close(drawn.T.cov(), seen.flatten(0, 2).T.cov(), atol=0.9, rtol=0.0)


def test_short_touches_are_used_for_training(pretrained: Pretrained) -> None:
    short = [cut(recording, 70) for recording in simulated(("Ann",), 2, ("pat", "hug"))]
    adapted = adapt(pretrained, short, HARDLY)
    assert [row.frames for row in adapted.comparison.lengths] == [54]


# --- figures ---


def labelled(text: str) -> list[Recording]:
    """Return a recording for each word: who, and what they do."""
    counts = np.zeros((60, 8, 8), np.uint16)
    return [
        Recording(who, "none", "none", gesture, counts, ideal_clock_ms(60), "live")
        for who, gesture in (word.split(":") for word in text.split())
    ]


@pytest.mark.parametrize(
    ("made", "left_out", "evaluated"),
    [
        ("A:pat B:pat A:hug B:hug", "participants", [0, 1, 2, 3]),
        # Only B did a hug: nobody else's recordings teach it.
        ("A:pat B:pat A:rub B:rub B:hug", "participants", [0, 1, 2, 3]),
        ("A:pat A:hug A:pat A:hug A:pat A:hug", "recordings", [0, 1, 2, 3, 4, 5]),
        ("A:pat A:hug", "nothing", []),
    ],
)
def test_people_or_else_recordings_are_held_out(made: str, left_out: str, evaluated: list[int]) -> None:
    recordings = labelled(made)
    held, folds = plan(recordings)
    assert held == left_out
    assert sorted(i for fold in folds for i in fold.evaluated) == evaluated
    for fold in folds:
        assert not {*fold.trained} & {*fold.evaluated}
        if left_out == "participants":
            trained = {recordings[i].participant for i in fold.trained}
            assert not trained & {recordings[i].participant for i in fold.evaluated}


def scored(text: str) -> dict[int, list[Scored]]:
    """Return a held-out recording for each word: who, what they do, and whether it is right afterwards."""
    tried = map(str.split, text.split(","))
    return {54: [Scored(who, gesture, 0.0, float(after)) for who, gesture, after in tried]}


@pytest.mark.parametrize(
    ("held_out", "left_out", "after", "interval"),
    [
        # t with 2 degrees of freedom: 4.303 standard errors of three participants' 1, 1 and 1/2.
        ("A pat 1, A rub 1, B pat 1, B rub 1, C pat 1, C rub 0", "participants", 5 / 6, (0.116, 1.550)),
        # People who changed equally prove nothing about others.
        ("A pat 1, A rub 1, B pat 1, B rub 1", "participants", 1.0, None),
        ("A pat 1, A pat 1, A rub 1, A rub 0", "recordings", 0.75, (-0.046, 1.546)),
    ],
)
def test_the_difference_has_an_interval(
    held_out: str, left_out: LeftOut, after: float, interval: tuple[float, float] | None
) -> None:
    (row,) = compare(scored(held_out), ("pat", "rub"), left_out).lengths
    assert (row.before, row.after) == (0.0, pytest.approx(after))
    assert row.interval == (interval and pytest.approx(interval, abs=1e-3))


@pytest.mark.parametrize(
    ("interval", "expected"),
    [
        (mean_interval(np.array([0.1])), None),
        # Equal but for rounding.
        (mean_interval(np.array([0.1 + 0.2, 0.3])), None),
        (mean_interval(np.array([0.0, 0.1])), (0.05 - 12.706 * 0.05, 0.05 + 12.706 * 0.05)),
        # Of 14 recordings, four more are right than before, or one.
        (mean_interval(np.array([1.0] * 4 + [0.0] * 10)), (0.015, 0.556)),
        (mean_interval(np.array([1.0] + [0.0] * 13)), (-0.083, 0.226)),
    ],
)
def test_few_values_have_a_wide_interval(
    interval: tuple[float, float] | None, expected: tuple[float, float] | None
) -> None:
    assert interval == (expected and pytest.approx(expected, abs=1e-3))


# --- warnings ---


@pytest.mark.parametrize(
    ("participants", "each", "warning"),
    [
        (("Ann",), 1, "whether this is better than the shipped model is unknown"),
        (("Ann",), 3, "One participant: no figure for other people"),
        (("Ann", "Bo"), 1, "Fewer than 3 participants: too few to tell whether others"),
    ],
)
def test_too_few_recordings_are_reported(
    pretrained: Pretrained, participants: Sequence[str], each: int, warning: str
) -> None:
    recordings = simulated(participants, each, ("pat", "hug"))
    assert warning in words(report_lines(adapt(pretrained, recordings, HARDLY)))


# --- touches in passing ---


def passing(gesture: str, frames: int, number: int = 0, *, after: int = 43) -> list[Recording]:
    """A saved touch: half a second of rest, `frames` of a gesture, and the rest after it."""
    (done,) = simulated(("A",), 1, (gesture,))
    (rest,) = simulated(("A",), 1, ("notouch",))
    pieces = ((rest, 0, 27), (done, number, frames), (rest, 40, after))
    clock_ms = np.split(ideal_clock_ms(27 + frames + after), [27, 27 + frames])
    return [
        replace(part, counts=part.counts[start : start + count], sensor_ms=own_ms, cover=f"c{number}")
        for (part, start, count), own_ms in zip(pieces, clock_ms, strict=True)
        if count
    ]


def saved(folder: Path, touches: Iterable[Sequence[Recording]]) -> Path:
    """Write touches as the daemon saves them, a file each."""
    folder.mkdir(exist_ok=True)
    for number, parts in enumerate(touches):
        write_recordings(folder / f"2026-11-20T10-00-0{number}.000Z-1-{number}.csv.gz", parts, {})
    return folder


def unlabelled(parts: Sequence[Recording]) -> list[Recording]:
    before, touch, after = parts
    return [before, replace(touch, gesture="unlabelled"), after]


@pytest.mark.parametrize(
    ("frames", "after", "found"),
    [
        (12, 43, (27, 39, 27 + 12 + 43)),
        (40, 43, (27, 67, 27 + 40 + 43)),
        # A long one is a recording like any other, without the rest beside it.
        (150, 43, (150,)),
        # A short one without rest after it is passed over.
        (20, 0, ()),
        (20, 5, ()),
    ],
)
def test_a_short_touch_is_read_with_the_rest_around_it(
    tmp_path: Path, frames: int, after: int, found: tuple[int, ...]
) -> None:
    others = [passing("pat", 12, 1), passing("stroke", 12, 2)]
    lab = saved(tmp_path / "lab", [*others, passing("rub", frames, after=after)])
    rubs = [each for each in read_all(lab, ()).recordings if each.gesture == "rub"]
    read = [
        (each.first, each.over, len(each.counts)) if isinstance(each, InPassing) else (len(each.counts),)
        for each in rubs
    ]
    assert read == ([found] if found else [])


def test_train_counts_the_saved_touches_that_it_skips(
    pretrained: Pretrained,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.setattr(Pretrained, "shipped", lambda: pretrained)
    monkeypatch.setattr(adapting, "SETTINGS", HARDLY)
    nobody = unlabelled(passing("rub", 30, 5))
    names = [("pat", 12, 0), ("stroke", 40, 1), ("pat", 15, 2), ("stroke", 30, 3)]
    cut_short = passing("pat", 20, 4, after=0)
    touches = [*(passing(*name) for name in names), nobody, unlabelled(passing("rub", 20, 6)), cut_short]
    lab = saved(tmp_path / "events.jsonl.touches", touches)
    began, now = "2026-11-20T10:00:05.000Z", "2026-11-20T11:00:00.000Z"
    label = Label(touch=1, began=began, gesture="stroke", time=now)
    (tmp_path / "events.jsonl").write_bytes(encode(label) + b"\n")
    assert cli.main(["train", "--extra", str(lab), "--output", str(tmp_path / "a.onnx"), "--keep-all"]) == 0
    said = capsys.readouterr().out
    assert "Passed over: 1 saved touch without a label" in said
    assert "Passed over: 1 saved touch cut short" in said
    assert "in passing: " in said
    assert "5 recordings of 2 gestures by 1 participant" in said
    assert Classifier.load(tmp_path / "a.onnx").labels == tuple(sorted(pretrained.labels))


def test_labels_beside_the_files_name_saved_touches(tmp_path: Path) -> None:
    touches = [passing("pat", 12, 1), passing("stroke", 12, 2), passing("rub", 12, 3)]
    lab = saved(tmp_path / "lab", map(unlabelled, touches))
    first, second, _ = sorted(path.name for path in lab.iterdir())
    found = read_all(lab, (), labels={first: "pat", second: "notouch"})
    # A false touch and the rest around it are one recording.
    assert sorted((each.gesture, len(each.counts)) for each in found.recordings) == [
        ("notouch", 27 + 12 + 43),
        ("pat", 27 + 12 + 43),
    ]
    assert found.passed_over == {"without a label": 1}
    with pytest.raises(ExtraError, match=r"nothing but pat, .*; label touches of another"):
        read_all(lab, (), labels={first: "pat"})


def test_touches_of_unknown_people_belong_to_the_only_known_one(tmp_path: Path) -> None:
    unknown = [replace(part, participant="unlabelled") for part in passing("pat", 12)]
    lab = saved(tmp_path / "lab", [unknown, passing("rub", 30, 1)])
    assert {each.participant for each in read_all(lab, ()).recordings} == {"A"}


def test_learning_from_single_pats_names_single_pats(pretrained: Pretrained) -> None:
    def read(each: Sequence[int]) -> list[Recording]:
        return [
            recording
            for number in each
            for gesture in ("pat", "scratch", "stroke")
            for recording in joined(passing(gesture, 20, number))
        ]

    settings, labels = AdaptSettings(crops=4, steps=100), pretrained.labels
    shown = crops(pretrained.backbone, read(range(4)), pretrained.augmentation, settings.crops, 0)
    head = fit(pretrained.head, labels, [], shown, pretrained.remembered.samples(labels, seed=0), settings)
    others = read(range(10, 14))
    answers = logits(head, windows(pretrained.backbone, others)[IN_PASSING]).argmax(axis=1)
    assert np.mean([labels[i] == each.gesture for i, each in zip(answers, others, strict=True)]) > 0.8


@pytest.mark.parametrize(
    ("left_out", "participants", "interval", "said"),
    [
        ("recordings", 1, (0.01, 0.2), ""),
        ("recordings", 1, (-0.01, 0.2), "Too little to tell"),
        ("recordings", 1, (-0.2, -0.01), "worse than the shipped model"),
        ("recordings", 1, None, "Too little to tell"),
        ("participants", 2, (0.01, 0.2), "Fewer than 3 participants"),
        ("participants", 3, (0.01, 0.2), ""),
    ],
)
def test_the_verdict_goes_as_far_as_chance_allows(
    adapted: Adapted,
    left_out: LeftOut,
    participants: int,
    interval: tuple[float, float] | None,
    said: str,
) -> None:
    last = LengthFigures(frames=144, gestures={}, before=0.7, after=0.8, interval=interval)
    measured = Comparison(left_out=left_out, participants=participants, lengths=[last])
    report = words(report_lines(replace(adapted, comparison=measured)))
    doubts = ("Too little to tell", "worse than the shipped model", "Fewer than 3 participants")
    assert [doubt for doubt in doubts if doubt in report] == ([said] if said else [])
    assert is_better(measured) == (said == "")


# --- unusable recordings ---

Make = Callable[[Path], object]
PAT, HUG, RUB = simulated(("A",), 1, ("pat", "hug", "rub"))


def kept(*recordings: Recording) -> Make:
    return lambda folder: keep(folder, recordings)


def pat_and(gesture: str) -> Make:
    return kept(PAT, replace(RUB, gesture=gesture))


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda folder: None, "cannot be read (No such file or directory)"),
        (kept(), "holds no recordings, and telling apart takes two gestures; make some with `touchd record"),
        (
            lambda folder: (keep(folder, []) / "a.csv.gz").write_bytes(b"not gzip"),
            "a.csv.gz: cannot be read as a recording",
        ),
        (kept(*simulated(("A",), 2, ("pat",))), "holds nothing but pat, and telling apart takes two"),
        (kept(*simulated(("A",), 2, ("notouch",))), "nothing but notouch"),
        (pat_and("high five"), "'high five' cannot name a gesture"),
        (pat_and(""), "'' cannot name a gesture"),
        (pat_and("uncertain"), "'uncertain' cannot name a gesture"),
        (kept(replace(PAT, gesture="unlabelled")), "nobody has said what its touches were"),
        (pat_and("Stroke"), "Stroke and stroke differ only in spelling"),
        (pat_and("no-touch"), "no-touch and notouch differ only in spelling"),
        (kept(PAT, cut(HUG, 53)), "0.98 s of hug without a gap, and at least 1 s is needed"),
        (kept(PAT, HUG, replace(PAT, cover="other")), "002.csv.gz: the same recording as in"),
    ],
)
def test_an_unusable_folder_is_refused_in_one_line(
    pretrained: Pretrained,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    make: Make,
    message: str,
) -> None:
    # Loaded once for all.
    monkeypatch.setattr(Pretrained, "shipped", lambda: pretrained)
    lab = tmp_path / "lab"
    make(lab)
    output = tmp_path / "lab.onnx"
    assert cli.main(["train", "--extra", str(lab), "--output", str(output)]) == 2
    shown = capsys.readouterr()
    assert message in shown.err
    assert len(shown.err.splitlines()) == 1
    assert not output.exists()


def test_training_without_recordings_names_where_recipes_are_trained(
    capsys: pytest.CaptureFixture[str],
) -> None:
    assert cli.main(["train"]) == 2
    assert "python -m touchd.model.studies train" in capsys.readouterr().err


def test_a_folder_with_too_many_gestures_is_refused(tmp_path: Path) -> None:
    known = [f"known{i}" for i in range(8)]
    lab = keep(tmp_path / "lab", simulated(("A",), 1))
    # As an interrupted session leaves it.
    (lab / ".partial-x.csv.gz").write_bytes(b"half")
    assert len(read_all(lab, known).recordings) == 5
    with pytest.raises(ExtraError, match="13 gestures; at most 12"):
        read_all(lab, known, keep_all=True)


def test_a_foreign_file_is_reported_before_teach_records(tmp_path: Path) -> None:
    (tmp_path / "participants.csv").write_text("name,age\nAnn,30\n")
    with pytest.raises(ExtraError, match=r"participants.csv: no known layout .*move it to another folder"):
        teach.main(options_of("teach", [str(tmp_path), "--participant", "ann"]))


def test_a_stopped_teach_does_not_end_as_a_finished_one(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("sys.stdin", io.StringIO("q\n"))
    assert teach.main(options_of("teach", [str(tmp_path)])) == 1
    assert "the same command continues from here" in capsys.readouterr().out
    assert list(tmp_path.iterdir()) == []
