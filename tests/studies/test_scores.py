"""The scores beside the shipped model belong to that file, cover the right windows, and can be reproduced."""

import hashlib
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from rigs.haart_folder import (
    HAART,
    SECOND_STUDY,
    THIRD_STUDY,
    needs_haart,
    needs_second_study,
    needs_third_study,
    one_person,
)

from touchd.drivers.recording import Recording, ideal_clock_ms, write_recordings
from touchd.model.classifier import SHIPPED_MODEL, Classifier
from touchd.model.studies.checks import evaluate
from touchd.model.studies.simulated import simulate
from touchd.model.training import haart, second_study
from touchd.model.training.studies import Folders

pytest.importorskip("torch", reason="needs the extra train")

from touchd.model.studies.__main__ import main
from touchd.model.studies.checks.scores import Scores, read_scores, splits
from touchd.model.training.recipe import SHIPPED_RECIPE, read_recipe
from touchd.model.training.weights import FABRIC_MODEL, HAART_MODEL, SCORES_NAME, WIDE_MODEL

HAART_PEOPLE = ["P10", "P3", "P4", "P5", "P6", "P7", "P8"]
SECOND_STUDY_PEOPLE = ["L1", "L2", *(f"R{i:02}" for i in (2, 3, 4, 6, 8, 9, 10, 11, 12, 14, 16, 17))]
THIRD_STUDY_PEOPLE = [f"S{i:02}" for i in (1, 3, 4, 6, 7, 8, 10, 11, 12, 14, 15, 18)]
FABRIC = {"haart": HAART_PEOPLE, "second": SECOND_STUDY_PEOPLE}
TOLERANCE = 0.002


@pytest.fixture(scope="module")
def scores() -> Scores:
    return read_scores(SHIPPED_MODEL.with_name(SCORES_NAME))


def stored(rows: list[evaluate.Score], frames: int) -> evaluate.Score:
    return next(row for row in rows if row.frames == frames)


def test_the_scores_are_those_of_the_shipped_file(scores: Scores) -> None:
    assert scores.model_sha256 == hashlib.sha256(SHIPPED_MODEL.read_bytes()).hexdigest()


SHIPPED = read_recipe()
WIDE, ALONE = (read_recipe(SHIPPED_RECIPE.with_name(name)) for name in ("haart-wide.yaml", "haart.yaml"))


@pytest.mark.parametrize(
    ("model", "name", "trained", "people"),
    [
        (SHIPPED_MODEL, SHIPPED.name, SHIPPED.settings.steps, {**FABRIC, "third": THIRD_STUDY_PEOPLE}),
        (FABRIC_MODEL, f"{SHIPPED.name}-fabric", SHIPPED.settings.steps, FABRIC),
        (WIDE_MODEL, WIDE.name, WIDE.settings.steps, {"haart": HAART_PEOPLE}),
        (HAART_MODEL, ALONE.name, ALONE.settings.steps, None),
    ],
    ids=["shipped", "fabric alone", "HAART alone, varied widely", "HAART alone"],
)
def test_a_model_file_names_its_training_data(
    model: Path, name: str, trained: int, people: dict[str, list[str]] | None
) -> None:
    metadata = Classifier.load(model).metadata
    assert metadata.name == name
    assert metadata.training["seed"] == 0
    assert metadata.training["left_out"] == []
    # Older files count epochs over HAART's recordings, of 108 steps each.
    assert metadata.training.get("steps", 108 * metadata.training.get("epochs", 0)) == trained
    assert metadata.training.get("learnt_from") == people


def test_a_fold_network_never_saw_the_participants_it_scores() -> None:
    for path in sorted((SHIPPED_MODEL.parent / "left_out").glob("*.onnx")):
        learnt_from = Classifier.load(path).metadata.training["learnt_from"]
        assert not {name for people in learnt_from.values() for name in people} & set(path.stem.split("-"))


@needs_haart
def test_a_test_participant_scores_as_published(scores: Scores, tmp_path: Path) -> None:
    recordings = haart.realigned(one_person(haart.TEST_FILE, "T9", tmp_path))
    again = evaluate.score([(Classifier.load(), recordings)], 54)
    # A window may fall the other way on another processor.
    published = stored(scores.test.realigned, 54)
    assert again.per_participant["T9"] == pytest.approx(published.per_participant["T9"], abs=0.01)


@needs_haart
@needs_second_study
@needs_third_study
@pytest.mark.slow
@pytest.mark.timeout(900)
def test_everybody_scores_as_published(scores: Scores) -> None:
    folders = Folders(*(Path(str(folder)) for folder in (HAART, SECOND_STUDY, THIRD_STUDY)))
    for key, split, missing in splits(folders, SHIPPED_MODEL.parent):
        live = [(classifier, haart.realigned(recordings)) for classifier, recordings in split]
        again = evaluate.score(live, 144, missing=missing)
        published = stored(getattr(scores, key).realigned, 144)
        assert again.windows == published.windows
        assert again.accuracy == pytest.approx(published.accuracy, abs=TOLERANCE), key
        assert again.calibration_error == pytest.approx(published.calibration_error, abs=0.01), key


@pytest.fixture
def small_haart(tmp_path: Path) -> Path:
    """A folder with two recordings per gesture of one test person and of one training person."""
    for name, person in ((haart.TEST_FILE, "T1"), (haart.TRAINING_FILE, "P3")):
        made = [replace(each, participant=person) for each in simulate([(g, 3.0) for g in haart.GESTURES], 3)]
        write_recordings(tmp_path / name, made, {})
    return tmp_path


def test_evaluating_shows_the_paper_and_leaves_the_clone_clean(
    small_haart: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    before = SHIPPED_MODEL.with_name(SCORES_NAME).read_bytes()
    missing = [f"--{study}={small_haart / 'none'}" for study in ("second-study", "third-study")]
    assert main(["evaluate", "--haart", str(small_haart), *missing]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert lines[1].startswith("HAART, test participants")
    assert lines[2].split()[-3:] == ["70.8", "71.1", "72.8"]
    for study, adds in (("second", "people"), ("third", "another kind of pad")):
        place = next(i for i, line in enumerate(lines) if line.startswith(f"{study} study: not scored"))
        assert lines[place + 1].startswith(f"  It adds {adds}")
    assert max(map(len, lines)) <= 80
    assert SHIPPED_MODEL.with_name(SCORES_NAME).read_bytes() == before


def test_evaluating_needs_no_extra() -> None:
    code = """
import sys
for name in ("torch", "onnx", "scipy", "sklearn", "matplotlib", "tqdm"):
    sys.modules[name] = None
import touchd.model.studies.making
import touchd.model.studies.checks.scores
"""
    subprocess.run([sys.executable, "-c", code], check=True, timeout=60)


def test_writing_scores_needs_every_study(small_haart: Path, capsys: pytest.CaptureFixture[str]) -> None:
    missing = str(small_haart / "none")
    assert main(["evaluate", "--write", "--haart", str(small_haart), "--second-study", missing]) == 2
    assert "needs all studies: --second-study" in capsys.readouterr().err


def test_a_gesture_that_a_study_lacks_is_not_an_answer(classifier: Classifier) -> None:
    tickled = [replace(each, gesture="scratch") for each in simulate([("tickle", 8.0)] * 3, 3)]
    others = simulate([("pat", 8.0), ("constant", 8.0)], 3)
    tickle = classifier.labels.index("tickle")
    free = evaluate.score([(classifier, [*tickled, *others])], 144)
    scored = evaluate.score([(classifier, [*tickled, *others])], 144, missing=("tickle",))
    assert sum(row[tickle] for row in free.confusion) > 0
    assert sum(row[tickle] for row in scored.confusion) == 0
    assert "tickle" not in scored.per_class


def whole_takes(takes: int) -> Recording:
    counts = np.arange(540 * takes, dtype=np.uint16)[:, None, None] % 1000 + np.zeros((8, 8), np.uint16)
    return Recording("R02", "static", "none", "rub", counts, ideal_clock_ms(len(counts)), "live")


def test_each_take_is_trained_on_without_its_edges() -> None:
    takes = second_study.takes([whole_takes(1), whole_takes(2)])
    assert [len(take.counts) for take in takes] == [486] * 3
    assert [int(take.counts[0, 0, 0]) for take in takes] == [27, 27, 567]
    # A take may lack its last frame.
    whole = whole_takes(1)
    (take,) = second_study.takes([replace(whole, counts=whole.counts[:539], sensor_ms=whole.sensor_ms[:539])])
    assert len(take.counts) == 486


def test_eight_seconds_of_the_first_take_are_scored() -> None:
    (scored,) = second_study.scored([whole_takes(2)])
    assert [int(scored.counts[i, 0, 0]) for i in (0, -1)] == [54, 485]
    assert len(scored.sensor_ms) == 432
