"""The scores that stand beside the shipped model are that file's own, and hold when measured again."""

from __future__ import annotations

import hashlib
from pathlib import Path

import pytest
from rigs.haart_folder import HAART, needs_haart

from model.checks import evaluate
from model.classifier import SHIPPED_MODEL, Classifier
from model.training import haart

pytest.importorskip("torch", reason="needs the extra train")

from model.training.recipe import read_recipe
from model.training.ship import SCORES_NAME, left_out_split

WEIGHTS = SHIPPED_MODEL.parent
DOCS = Path(__file__).parents[2] / "docs"
TOLERANCE = 0.002
"""A window or two may fall the other way on another processor."""


@pytest.fixture(scope="module")
def scores() -> evaluate.Scores:
    return evaluate.read_scores(WEIGHTS / SCORES_NAME)


def stored(rows: list[evaluate.Score], frames: int) -> evaluate.Score:
    return next(row for row in rows if row.frames == frames)


def test_the_scores_are_those_of_the_shipped_file(scores: evaluate.Scores) -> None:
    assert scores.model_sha256 == hashlib.sha256(SHIPPED_MODEL.read_bytes()).hexdigest()


def test_the_accuracy_page_says_what_the_scores_say(scores: evaluate.Scores) -> None:
    from docs.studies.accuracy import page_lines

    assert (DOCS / "accuracy.md").read_text(encoding="utf-8") == "\n".join(page_lines(scores)) + "\n"


def test_the_shipped_file_says_how_it_was_trained() -> None:
    recipe = read_recipe()
    metadata = Classifier.load().metadata
    assert metadata.name == recipe.name
    assert metadata.training["seed"] == recipe.seeds[0]
    assert metadata.training["left_out"] == []
    assert metadata.training["epochs"] == recipe.settings.epochs


def test_every_training_participant_is_left_out_exactly_once() -> None:
    left_out = sorted(participant for fold in read_recipe().folds for participant in fold)
    assert left_out == sorted(["P3", "P4", "P5", "P6", "P7", "P8", "P10"])


@needs_haart
@pytest.mark.timeout(120)
@pytest.mark.parametrize("frames", [54, 144])
def test_the_test_participants_score_as_published(scores: evaluate.Scores, frames: int) -> None:
    recordings = haart.realigned(haart.read_test(Path(str(HAART))))
    again = evaluate.score([(Classifier.load(), recordings)], frames)
    published = stored(scores.test.realigned, frames)
    assert again.windows == published.windows
    assert again.accuracy == pytest.approx(published.accuracy, abs=TOLERANCE)
    assert again.calibration_error == pytest.approx(published.calibration_error, abs=0.01)


@needs_haart
@pytest.mark.timeout(120)
def test_the_left_out_participants_score_as_published(scores: evaluate.Scores) -> None:
    recordings = haart.realigned(haart.read_training(Path(str(HAART))))
    again = evaluate.score(left_out_split(WEIGHTS, recordings), 144)
    assert again.accuracy == pytest.approx(stored(scores.left_out.realigned, 144).accuracy, abs=TOLERANCE)
