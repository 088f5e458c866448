"""Sessions of a pad in use: how they are made and scored, and that touches stay separate."""

from pathlib import Path

import msgspec
import numpy as np
import pytest
from rigs.haart_folder import SECOND_STUDY, needs_second_study, recordings_of
from rigs.made_pad import MadePad, Scans, nothing, palm, pat
from rigs.scripted_model import Scripted

from touchd.daemon.path.events import TouchEnded, epoch_s, timestamp
from touchd.drivers.recording import Recording, ideal_clock_ms, read_recordings
from touchd.model.classifier import SHIPPED_MODEL, Classifier
from touchd.model.studies.play import frames_of, play
from touchd.model.studies.sessions.plan import PlannedSession, SessionSettings, sessions
from touchd.model.studies.sessions.score import judge, score
from touchd.model.studies.tables import session_figures


def recording(gesture: str, scans: Scans, shift: float = 0.0) -> Recording:
    pad = MadePad()
    pad.rest += shift
    counts = pad.counts(scans)
    return Recording("P", "foam", "none", gesture, counts, ideal_clock_ms(len(counts)), "live")


def made(settings: SessionSettings) -> PlannedSession:
    touches = [recording("pat", pat(8.0), shift=4.0), recording("constant", palm(8.0, counts=60.0))]
    (session,) = sessions([recording("notouch", nothing(8.0)), *touches], settings)
    return session


def test_a_session_shifts_the_rest_after_a_pat() -> None:
    session = made(SessionSettings())
    levels = [session.counts[each.start : each.stop].mean() for each in session.stretches]
    pat = [each.gesture for each in session.stretches].index("pat")
    assert levels[pat + 1] - levels[0] == pytest.approx(4.0, abs=1.0)


def test_noise_begins_at_its_time_and_not_before() -> None:
    clean, noisy = made(SessionSettings()), made(SessionSettings(noise=3.0))
    assert (clean.counts[:540] == noisy.counts[:540]).all()
    assert (clean.counts[540:] != noisy.counts[540:]).mean() > 0.5


@pytest.mark.parametrize(
    "disturbance", [pytest.param({}, marks=pytest.mark.slow), {"noise": 1.5}, {"hum": 2.0}, {"motor": 2.0}]
)
def test_the_touches_of_a_session_stay_apart(disturbance: dict[str, float], classifier: Classifier) -> None:
    session = made(SessionSettings(**disturbance))
    result = score([judge(session, play(frames_of(session.counts), classifier))])
    assert (result.n, result.missed, result.merged, result.split, result.open) == (2, 0.0, 0.0, 0.0, 0.0)


def test_a_touch_that_never_closes_is_scored_as_merged() -> None:
    session = made(SessionSettings())
    events = play(frames_of(session.counts), Scripted())
    first_end = next(i for i, event in enumerate(events) if type(event).__name__ == "TouchEnded")
    result = score([judge(session, events[:first_end])])
    assert result.merged == result.open == 100.0


def test_a_touch_that_ends_late_is_scored_as_open() -> None:
    session = made(SessionSettings())
    events = play(frames_of(session.counts), Scripted())
    late = [
        msgspec.structs.replace(event, time=timestamp(epoch_s(event.time) + 2.0))
        if isinstance(event, TouchEnded)
        else event
        for event in events
    ]
    assert score([judge(session, late)]).open == 100.0


@needs_second_study
@pytest.mark.slow
def test_a_breathing_robots_answers_are_as_measured(tmp_path: Path) -> None:
    touches, missed, split, final = 24, 4.2, 4.2, 62.5
    moving = "(R04|R06),dynamic,"
    recordings = read_recordings(recordings_of("robot-pad.csv", moving, tmp_path, SECOND_STUDY))
    never_met_them = SHIPPED_MODEL.parent / "left_out" / "P4-R04-R06-S03-S10.onnx"
    result = session_figures([(Classifier.load(never_met_them), recordings)], SessionSettings())
    assert result["n"] == touches
    assert (result["missed"], result["merged"], result["split"]) == (missed, 0, split)
    assert (result["open"], result["false"]) == (0, 0)
    # Another processor's rounding may change a single answer.
    assert result["final"] == pytest.approx(final, abs=100 / touches + 0.1)


def test_quiet_alone_has_no_false_touch() -> None:
    session = made(SessionSettings())
    quiet = PlannedSession("P", "foam", "none", session.counts[:162], session.stretches[:1])
    played = judge(quiet, play(frames_of(quiet.counts), Scripted()))
    assert played.false == 0
    assert np.isclose(played.quiet_min, 0.05)
