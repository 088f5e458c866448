"""A board that restarts costs no touch, and is reported."""

import logging
from collections.abc import Iterator

import numpy as np
import pytest
from rigs.made_pad import MadePad, Scans, nothing, palm

from touchd.daemon.path.events import Event, Prediction, SensorEvent, TouchEnded
from touchd.daemon.path.monitor import PadMonitor
from touchd.daemon.path.pipeline import Clock, Pipeline, PipelineSettings
from touchd.drivers.fakes.encode import encode_frame
from touchd.drivers.frame import Counts
from touchd.drivers.pad.format import PRESETS, PadFormat
from touchd.drivers.pad.parser import FrameParser
from touchd.model.classifier import Classifier

PERIOD_S = 3.0
FABRIC, CSV = PRESETS["fabric-grid"], PRESETS["csv"]
TWO_TOUCHES = [nothing(2.0), *[palm(4.0), nothing(4.0)] * 2, nothing(4.0)]


class Board:
    """A pad's bytes through parser, pipeline and monitor; every `period_s` its clock begins at 7 ms again.

    pause_s: for which it sends nothing when it starts.
    """

    def __init__(self, described: PadFormat, period_s: float, pause_s: float = 0.0) -> None:
        self.described = described
        self.period_s, self.pause_s = period_s, pause_s
        self.events: list[Event] = []
        self.now_s = 100.0
        self.parser: FrameParser = FrameParser(described)

    def feel(self, model: Classifier, *pressures: Scans) -> "Board":
        """Send what the pad feels."""
        pipeline = Pipeline(
            PipelineSettings(),
            model,
            self.events.append,
            Clock(lambda: self.now_s),
            monitor=PadMonitor(parser=self.parser),
        )
        for data in self._sent(MadePad().counts(np.concatenate(pressures))):
            self.now_s += 1 / 54
            for frame in self.parser.feed(data, self.now_s):
                pipeline.on_frame(frame)
        pipeline.flush()
        return self

    def _sent(self, scans: Counts) -> Iterator[bytes]:
        since_s = 0.0
        for number, counts in enumerate(scans):
            second = number / 54
            if second - since_s >= self.period_s:
                since_s = second
            if second - since_s < self.pause_s and number > self.period_s * 54:
                yield b""
                continue
            yield encode_frame(self.described, counts, 7 + round(1000 * (second - since_s)))

    @property
    def ends(self) -> list[str]:
        return [event.reason for event in self.events if isinstance(event, TouchEnded)]

    @property
    def finals(self) -> int:
        return sum(isinstance(event, Prediction) and event.stage == "final" for event in self.events)


@pytest.mark.parametrize("described", [FABRIC, CSV], ids=["binary", "text"])
def test_a_touch_goes_on_while_the_board_restarts(described: PadFormat, classifier: Classifier) -> None:
    board = Board(described, PERIOD_S).feel(classifier, *TWO_TOUCHES)
    assert board.ends == ["released"] * 2
    assert board.finals == 2
    assert board.parser.counts.restarts == 7


def test_rest_stays_known_while_a_board_restarts_under_a_hand(classifier: Classifier) -> None:
    board = Board(FABRIC, 6.0, pause_s=1.2).feel(classifier, nothing(4.0), palm(5.0), nothing(5.0))
    # The hand is there before and after the pause.
    assert board.ends == ["gap", "released"]


def test_a_board_that_often_restarts_is_reported(
    classifier: Classifier, caplog: pytest.LogCaptureFixture
) -> None:
    board = Board(FABRIC, 5.0).feel(classifier, nothing(27.0))
    assert board.parser.counts.restarts == 5
    (told,) = [event for event in board.events if isinstance(event, SensorEvent)]
    assert (told.state, "the pad restarted 3 times in a minute" in told.reason) == ("degraded", True)
    (line,) = [record.message for record in caplog.records if record.levelno >= logging.WARNING]
    assert "supply" in line
