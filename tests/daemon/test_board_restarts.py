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
WITHOUT_CLOCK = PadFormat(framing="text", rows=8, columns=8)
TWO_TOUCHES = [nothing(2.0), *[palm(4.0), nothing(4.0)] * 2, nothing(4.0)]
CRASH = (
    b"Guru Meditation Error: Core  1 panic'ed (LoadProhibited). Exception was unhandled.\r\n"
    b"PC      : 0x400d1a2c  PS      : 0x00060c30  A0      : 0x800d2b44  A1      : 0x3ffb1f90\r\n"
    b"A2      : 0x00000000  A3      : 0x3ffb8a10  A4      : 0x00000001  A5      : 0x00000003\r\n"
    b"Backtrace: 0x400d1a29:0x3ffb1f90 0x400d2b41:0x3ffb1fb0\r\n\r\nRebooting...\r\n"
    b"ets Jun  8 2016 00:22:57\r\n\r\nrst:0xc (SW_CPU_RESET),boot:0x13 (SPI_FAST_FLASH_BOOT)\r\n"
    b"configsip: 0, SPIWP:0xee\r\nload:0x3fff0030,len:1184\r\nentry 0x400805f0\r\n"
)


class Board:
    """A pad's bytes through parser, pipeline and monitor; every `period_s` its clock begins at 7 ms again.

    log: what it prints when it starts. pause_s: for which it then sends nothing.
    """

    def __init__(self, described: PadFormat, period_s: float, log: bytes = b"", pause_s: float = 0.0) -> None:
        self.described, self.log = described, log
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
        since_s, before = 0.0, b""
        for number, counts in enumerate(scans):
            second = number / 54
            if second - since_s >= self.period_s:
                since_s, before = second, self.log
            if second - since_s < self.pause_s and number > self.period_s * 54:
                yield b""
                continue
            yield before + encode_frame(self.described, counts, 7 + round(1000 * (second - since_s)))
            before = b""

    @property
    def ends(self) -> list[str]:
        return [event.reason for event in self.events if isinstance(event, TouchEnded)]

    @property
    def finals(self) -> int:
        return sum(isinstance(event, Prediction) and event.stage == "final" for event in self.events)


@pytest.mark.parametrize(
    ("described", "log"), [(FABRIC, b""), (CSV, CRASH)], ids=["silently", "with a crash log"]
)
def test_a_touch_goes_on_while_the_board_restarts(
    described: PadFormat, log: bytes, classifier: Classifier
) -> None:
    board = Board(described, PERIOD_S, log).feel(classifier, *TWO_TOUCHES)
    assert board.ends == ["released"] * 2
    assert board.finals == 2
    assert board.parser.counts.restarts == 7


def test_rest_stays_known_while_a_board_restarts_under_a_hand(classifier: Classifier) -> None:
    board = Board(FABRIC, 6.0, pause_s=1.2).feel(classifier, nothing(4.0), palm(5.0), nothing(5.0))
    # The hand is there before and after the pause.
    assert board.ends == ["gap", "released"]


@pytest.mark.parametrize(("described", "log"), [(FABRIC, b""), (WITHOUT_CLOCK, CRASH)], ids=["clock", "log"])
def test_a_board_that_often_restarts_is_reported(
    described: PadFormat, log: bytes, classifier: Classifier, caplog: pytest.LogCaptureFixture
) -> None:
    board = Board(described, 5.0, log).feel(classifier, nothing(27.0))
    assert board.parser.counts.restarts == 5
    (told,) = [event for event in board.events if isinstance(event, SensorEvent)]
    assert (told.state, "the pad restarted 3 times in a minute" in told.reason) == ("degraded", True)
    (line,) = [record.message for record in caplog.records if record.levelno >= logging.WARNING]
    assert "supply" in line


@pytest.mark.parametrize("described", [FABRIC, CSV, WITHOUT_CLOCK], ids=["binary", "text", "rows"])
def test_a_long_register_dump_and_the_boot_log_after_it_are_one_restart(described: PadFormat) -> None:
    parser, still, now_s = FrameParser(described), MadePad().counts(nothing(3.0)), 100.0
    for number in range(3 * len(still)):
        clock_ms = 7 + 1000 * (number % len(still)) // 54
        if number in (len(still), 2 * len(still)):
            first, *dump, last = CRASH.splitlines(keepends=True)
            for line in (first, *dump * 10, last, *dump, b"rst:0xc (SW_CPU_RESET)\r\n"):
                now_s += 0.05
                parser.feed(line, now_s)
        now_s += 1 / 54
        parser.feed(encode_frame(described, still[number % len(still)], clock_ms), now_s)
    assert parser.counts.restarts == 2
