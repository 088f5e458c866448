"""The tracker's committed figures, checked again on a part of their recordings."""

import os
import statistics
from pathlib import Path

import msgspec
import pytest
from rigs.haart_folder import needs_haart

from daemon.events import Event, Prediction
from daemon.pipeline import Pipeline, PipelineSettings
from daemon.touch import TouchSettings
from docs.studies.tracker.figures import (
    MAX_DELAY_MS,
    MAX_FALSE_PER_10_MIN,
    MAX_MISSED,
    TouchReport,
    at_level,
    point,
)
from docs.studies.tracker.measure import spliced
from docs.studies.training.haart import TRAINING_FILE, find
from drivers.frame import Frame
from drivers.recording import NO_TOUCH, Recording, Selection, ideal_clock_ms, read_recordings, realign
from model.classifier import Classifier

FIGURES = Path(__file__).parents[2] / "docs" / "touch.json"
SAMPLE = "P6"


@pytest.fixture(scope="module")
def committed() -> TouchReport:
    return msgspec.json.decode(FIGURES.read_bytes(), type=TouchReport)


@pytest.fixture(scope="module")
def recordings() -> list[Recording]:
    path = find(Path(os.environ["TOUCHD_HAART"]), TRAINING_FILE)
    return [realign(recording) for recording in read_recordings(path, Selection(participants=(SAMPLE,)))]


@pytest.mark.parametrize("splice", ["as recorded", "rest levelled"])
def test_the_committed_figures_meet_the_targets_on_participants_left_out(
    committed: TouchReport, splice: str
) -> None:
    points = [row.figures for row in committed.held_out[splice]]
    assert len(points) == 7
    touches, minutes = sum(row.touches for row in points), sum(row.notouch_min for row in points)
    assert sum(row.missed for row in points) <= MAX_MISSED * touches
    assert 10 * sum(row.false_touches for row in points) <= MAX_FALSE_PER_10_MIN * minutes
    # Light contact must move, or a shifted rest would be a touch; for one participant this takes 130 ms.
    assert statistics.median(row.delay_ms_median for row in points) <= MAX_DELAY_MS
    unseen = committed.unseen[splice]
    assert unseen.missed <= MAX_MISSED * unseen.touches
    assert unseen.delay_ms_median <= MAX_DELAY_MS


def test_the_committed_figures_are_those_of_the_default_settings(committed: TouchReport) -> None:
    assert committed.settings == TouchSettings()


@needs_haart
def test_the_committed_figures_hold_for_a_participant(
    committed: TouchReport, recordings: list[Recording]
) -> None:
    (row,) = [row for row in committed.held_out["rest levelled"] if row.participant == SAMPLE]
    level = row.figures.onset_threshold
    cases = spliced(recordings, level_rest=True)
    noticed = at_level(level, SAMPLE, cases, recordings, committed.settings)
    assert point(level, [noticed]) == row.figures


@needs_haart
def test_a_minute_of_notouch_tells_the_robot_nothing(recordings: list[Recording]) -> None:
    quiet = [recording for recording in recordings if recording.gesture == NO_TOUCH][:8]
    emitted: list[Event] = []
    pipeline = Pipeline(PipelineSettings(), Classifier.load(), emitted.append)
    for number, recording in enumerate(quiet):
        # Each was made on another cover: the pad is silent in between, as when covers are changed.
        clock = ideal_clock_ms(len(recording.counts), first_ms=number * 60_000)
        for ms, counts in zip(clock, recording.counts, strict=True):
            pipeline.on_frame(Frame(0, int(ms), 0.0, counts))
    pipeline.flush()
    assert sum(len(recording.counts) for recording in quiet) >= 60 * 54
    assert not any(isinstance(event, Prediction) and event.told for event in emitted)
