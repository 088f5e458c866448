"""The stored figures of detection, checked again on a part of their recordings."""

import pytest
from rigs.haart_folder import needs_haart, one_person

from touchd.daemon.path.events import Prediction
from touchd.daemon.path.tracker import SENSITIVITIES
from touchd.drivers.frame import NO_TOUCH, Frame
from touchd.drivers.recording import Recording, ideal_clock_ms
from touchd.model.classifier import Classifier
from touchd.model.studies.play import detect, detector_for, play
from touchd.model.studies.results import Results
from touchd.model.studies.tables import DETECTION_FILE as FILE
from touchd.model.studies.tables import PLAIN, session_figures
from touchd.model.training import haart
from touchd.model.training.recipe import read_recipe
from touchd.model.training.weights import FABRIC_MODEL, fold_path, left_out_split

SAMPLE = "P6"


@pytest.fixture(scope="module")
def recordings(tmp_path_factory: pytest.TempPathFactory) -> list[Recording]:
    folder = tmp_path_factory.mktemp("haart")
    return haart.realigned(one_person(haart.TRAINING_FILE, SAMPLE, folder))


@pytest.mark.parametrize(
    ("row", "missed", "merged", "split", "false"),
    [
        ("sessions/HAART test", 0.5, 0.5, 1.5, 0.3),
        ("sessions/HAART", 1.4, 1.0, 2.4, 1.0),
        ("sessions/robot still", 3.0, 1.0, 2.9, 2.2),
        ("sessions/robot breathes", 2.0, 2.0, 4.8, 3.0),
    ],
)
def test_touches_of_people_never_seen_are_found(
    row: str, missed: float, merged: float, split: float, false: float
) -> None:
    found = Results(FILE).get(row)
    assert found["missed"] <= missed
    assert found["merged"] <= merged
    assert found["split"] <= split
    assert found["false"] <= false


def test_a_firm_pads_touches_are_seldom_merged_or_left_open() -> None:
    rows = [Results(FILE).get(f"firm pad/{hz} Hz sent at 54") for hz in (12, 8)]
    assert all(row["merged"] <= 6 and row["open"] <= 4 and row["missed"] == 0 for row in rows)


def test_a_higher_sensitivity_finds_touches_sooner() -> None:
    delays = [Results(FILE).get(f"sensitivity/{level}")["p90_ms"] for level in SENSITIVITIES]
    assert delays == sorted(delays, reverse=True)


@pytest.mark.parametrize("fold", read_recipe().folds, ids="-".join)
def test_every_network_has_a_detector_that_saw_no_more_people(fold: tuple[str, ...]) -> None:
    model = Classifier.load(fold_path(FABRIC_MODEL.parent, fold))
    assert set(fold) <= set(detector_for(model).training["left_out"])


def test_the_fabric_networks_detector_never_met_the_third_pad() -> None:
    assert detector_for(Classifier.load(FABRIC_MODEL)).training["left_out_study"] == "third"


@needs_haart
def test_the_stored_figures_hold_for_a_person(recordings: list[Recording]) -> None:
    bare = [each for each in recordings if each.cover == "none"]
    result = session_figures(left_out_split(FABRIC_MODEL.parent, bare), PLAIN, detect)
    assert (result["missed"], result["merged"], result["false"]) == (0.0, 0.0, 0.0)


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
