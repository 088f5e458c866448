"""A board that restarts costs no touch, and is reported."""

import logging

import numpy as np
import pytest
from rigs.made_pad import MadePad, Scans, nothing, palm

from touchd.daemon.path.events import Event, Prediction, SensorEvent, TouchEnded
from touchd.daemon.path.monitor import PadMonitor
from touchd.daemon.path.pipeline import Clock, Pipeline, PipelineSettings
from touchd.drivers.fakes.encode import encode_frame
from touchd.drivers.pad.format import PRESETS, PadFormat
from touchd.drivers.pad.parser import FrameParser
from touchd.model.classifier import Classifier

FABRIC, CSV = PRESETS["fabric-grid"], PRESETS["csv"]


def told(
    model: Classifier, described: PadFormat, every_s: float, *pressures: Scans, pause_s: float = 0.0
) -> tuple[list[Event], int]:
    """Return the events of a pad whose clock begins at 7 ms again every few seconds, and how often it did.

    pause_s: for which it sends nothing when it restarts.
    """
    parser, events, now_s = FrameParser(described), list[Event](), 100.0
    clock = Clock(lambda: now_s)
    monitor = PadMonitor(parser=parser)
    pipeline = Pipeline(PipelineSettings(), model, events.append, clock, monitor=monitor)
    for number, counts in enumerate(MadePad().counts(np.concatenate(pressures))):
        now_s += 1 / 54
        restarts, frame = divmod(number, round(54 * every_s))
        if restarts and frame < 54 * pause_s:
            continue
        for read in parser.feed(encode_frame(described, counts, 7 + round(1000 * frame / 54)), now_s):
            pipeline.on_frame(read)
    pipeline.flush()
    return events, parser.counts.restarts


def ends(events: list[Event]) -> list[str]:
    return [event.reason for event in events if isinstance(event, TouchEnded)]


@pytest.mark.parametrize("described", [FABRIC, CSV], ids=["binary", "text"])
def test_a_touch_goes_on_while_the_board_restarts(described: PadFormat, classifier: Classifier) -> None:
    touches = [palm(4.0), nothing(4.0)] * 2
    events, restarts = told(classifier, described, 3.0, nothing(2.0), *touches, nothing(4.0))
    assert (restarts, ends(events)) == (7, ["released"] * 2)
    assert sum(isinstance(event, Prediction) and event.stage == "final" for event in events) == 2


def test_rest_stays_known_while_a_board_restarts_under_a_hand(classifier: Classifier) -> None:
    events, _ = told(classifier, FABRIC, 6.0, nothing(4.0), palm(5.0), nothing(5.0), pause_s=1.2)
    # The hand is there before and after the pause.
    assert ends(events) == ["gap", "released"]


def test_a_board_that_often_restarts_is_reported(
    classifier: Classifier, caplog: pytest.LogCaptureFixture
) -> None:
    events, restarts = told(classifier, FABRIC, 5.0, nothing(27.0))
    assert restarts == 5
    (state,) = [event for event in events if isinstance(event, SensorEvent)]
    assert (state.state, "the pad restarted 3 times in a minute" in state.reason) == ("degraded", True)
    (line,) = [record.message for record in caplog.records if record.levelno >= logging.WARNING]
    assert "supply" in line
