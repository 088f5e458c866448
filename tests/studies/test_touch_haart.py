"""The tracker's committed figures, checked again on a part of their recordings."""

import statistics

import msgspec
import pytest
from rigs.haart_folder import needs_haart, one_person

from touchd.daemon.path.events import Prediction
from touchd.daemon.path.tracker import TouchSettings
from touchd.drivers.frame import NO_TOUCH, Frame
from touchd.drivers.recording import Recording, ideal_clock_ms
from touchd.model.classifier import Classifier
from touchd.model.studies.play import play
from touchd.model.studies.tracker import figures, report
from touchd.model.studies.tracker.figures import TouchReport
from touchd.model.studies.tracker.measure import spliced
from touchd.model.training import haart

SAMPLE = "P6"


@pytest.fixture(scope="module")
def committed() -> TouchReport:
    return msgspec.json.decode(report.FILE.read_bytes(), type=TouchReport)


@pytest.fixture(scope="module")
def recordings(tmp_path_factory: pytest.TempPathFactory) -> list[Recording]:
    folder = tmp_path_factory.mktemp("haart")
    return haart.realigned(one_person(haart.TRAINING_FILE, SAMPLE, folder))


@pytest.mark.parametrize("splice", ["as recorded", "rest levelled"])
def test_the_committed_figures_meet_the_targets_on_people_held_out(
    committed: TouchReport, splice: str
) -> None:
    points = [row.figures for row in committed.held_out[splice]]
    assert len(points) == 7
    touches, minutes = sum(row.touches for row in points), sum(row.notouch_min for row in points)
    assert sum(row.missed for row in points) <= figures.MAX_MISSED * touches
    assert 10 * sum(row.false_touches for row in points) <= figures.MAX_FALSE_PER_10_MIN * minutes
    # Light contact must move to count as a touch, which a shifted rest does not; one person takes 130 ms.
    assert statistics.median(row.delay_ms_median for row in points) <= figures.MAX_DELAY_MS
    unseen = committed.unseen[splice]
    assert unseen.missed <= figures.MAX_MISSED * unseen.touches
    assert unseen.delay_ms_median <= figures.MAX_DELAY_MS


def test_the_committed_figures_are_those_of_the_default_settings(committed: TouchReport) -> None:
    assert committed.settings == TouchSettings()


def test_a_lower_threshold_than_the_default_is_too_low_for_a_noisier_pad(committed: TouchReport) -> None:
    false = {point.onset_threshold: point.false_per_10_min for point in committed.noisy}
    assert false[TouchSettings().onset_threshold] <= figures.MAX_FALSE_PER_10_MIN < false[2.0]


@needs_haart
def test_the_committed_figures_hold_for_a_participant(
    committed: TouchReport, recordings: list[Recording]
) -> None:
    (row,) = [row for row in committed.held_out["rest levelled"] if row.participant == SAMPLE]
    level = row.figures.onset_threshold
    quiet = [recording for recording in recordings if recording.gesture == NO_TOUCH]
    outcome = figures.at_level(level, spliced(recordings, level_rest=True), quiet, committed.settings)
    assert figures.point(level, [outcome]) == row.figures


@needs_haart
def test_a_minute_of_notouch_tells_the_robot_nothing(recordings: list[Recording]) -> None:
    quiet = [recording for recording in recordings if recording.gesture == NO_TOUCH][:8]
    # Each was made on another cover: the pad is silent in between, as when covers are changed.
    frames = (
        Frame(int(ms), ms / 1000.0, counts)
        for number, recording in enumerate(quiet)
        for ms, counts in zip(
            ideal_clock_ms(len(recording.counts), first_ms=number * 60_000), recording.counts, strict=True
        )
    )
    emitted = play(frames, Classifier.load(), flush=True)
    assert sum(len(recording.counts) for recording in quiet) >= 60 * 54
    assert not any(isinstance(event, Prediction) and event.told for event in emitted)
