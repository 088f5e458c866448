"""A line that loses a part of the pad's frames is told of in the log, with what to do."""

import logging

import numpy as np
import pytest
from rigs.formats import FabricGrid, encode_fabric_grid
from rigs.line_faults import Faults
from rigs.sensor_rig import next_frames, sensing, stream_of

from touchd.drivers.fakes.fake_port import FakePort
from touchd.drivers.frame import CLOCK_MODULUS, Counts
from touchd.drivers.pad import line_watch
from touchd.drivers.pad.format import PadFormat, encode_frame
from touchd.drivers.pad.line_watch import LOOK_S, LineWatch
from touchd.drivers.pad.parser import FrameParser
from touchd.drivers.pad.protocol import parser_of
from touchd.drivers.pad.watch import SAME_TROUBLE_S

SENT = PadFormat(framing="text", skip=1, rows=8, columns=8, full_scale=4095)
CONFIGURED = PadFormat(framing="text", skip=1, rows=8, columns=8, full_scale=1023)
FIRM = "COM3: values above full_scale 1023 are cut to it; set the most that a cell can send in sensor.format"
MANY = "5 % of the last frames were refused, damaged on the way"
TRY = "and another USB port, no hub"
UDP = "udp://0.0.0.0:4000"


def watch(
    parser: FrameParser, packets: list[bytes], turns: int = 1, where: str = "COM3", looks: int = 1
) -> None:
    """Let the packets arrive over one look, or several, again and again, after a first frame."""
    watched = LineWatch(parser, where)
    watched.update(0.0)
    for turn in range(turns):
        for number, packet in enumerate(packets, 1):
            now_s = LOOK_S * looks * (turn + number / len(packets))
            parser.feed(packet, now_s)
            watched.update(now_s)


def pressed(counts: int, numbers: range) -> list[bytes]:
    frame = np.full((8, 8), counts, np.uint16)
    return [encode_frame(SENT, frame, round(1000 * number / 54)) for number in numbers]


FIRM_PRESSES = pressed(100, range(420)) + pressed(900, range(420, 540))


def faulty(**every: int) -> list[bytes]:
    faults, stream = Faults(**every), stream_of(540)
    sent = zip(stream.counts, stream.sensor_ms.tolist(), strict=True)
    return [faults.on_line(number, encode_fabric_grid(*frame)) for number, frame in enumerate(sent, 1)]


@pytest.mark.parametrize(
    ("ms_a_second", "is_told"), [(500, True), (900, False), (1100, False), (2000, True), (300_000, False)]
)
def test_a_clock_that_does_not_count_milliseconds_is_told_once(
    caplog: pytest.LogCaptureFixture, ms_a_second: int, is_told: bool
) -> None:
    watched = LineWatch(FabricGrid(), "COM3")
    for half_seconds in range(100):
        watched.update(half_seconds / 2, round(half_seconds / 2 * ms_a_second) % CLOCK_MODULUS)
    told = [
        f"COM3: the pad's clock counts {ms_a_second} in a second; it must count milliseconds, or touches "
        "seem shorter or longer than they are"
    ]
    assert caplog.messages == (told if is_told else [])


@pytest.mark.parametrize("pause_s", [0.0, 3.0])
def test_a_clock_is_not_compared_over_a_pause_or_another_opening(
    caplog: pytest.LogCaptureFixture, pause_s: float
) -> None:
    watched = LineWatch(FabricGrid(), "COM3")
    for half_seconds in range(29):
        watched.update(half_seconds / 2, 500 * half_seconds)
    if not pause_s:
        watched.forget_clock()
    # Another pad's clock, or one of which some seconds were lost, from the fifth second of a look on.
    for half_seconds in range(29, 100):
        watched.update(half_seconds / 2 + pause_s, 500 * half_seconds + 8000)
    assert caplog.messages == []


@pytest.mark.parametrize(
    ("parser", "packets", "where", "told"),
    [
        (parser_of(CONFIGURED), FIRM_PRESSES, "COM3", FIRM),
        (FabricGrid(), faulty(flip_bit_every=20), "COM3", f"COM3: {MANY}; try a shorter cable {TRY}"),
        (FabricGrid(), faulty(flip_bit_every=20), UDP, f"{UDP}: {MANY}; does another board send there too?"),
        (FabricGrid(), faulty(), "COM3", None),
        (FabricGrid(), faulty(flip_bit_every=100), "COM3", None),
        (FabricGrid(), faulty(repeat_frame_every=5), "COM3", None),
    ],
    ids=["firm presses", "damage", "damage on a network", "sound", "little damage", "repeats"],
)
def test_what_a_line_loses_is_told_with_what_to_do(
    parser: FrameParser, packets: list[bytes], where: str, told: str | None, caplog: pytest.LogCaptureFixture
) -> None:
    watch(parser, packets, where=where)
    assert caplog.messages == ([told] if told else [])


def test_the_same_trouble_is_told_once_in_ten_minutes(caplog: pytest.LogCaptureFixture) -> None:
    damaged = faulty(flip_bit_every=20)
    watch(FabricGrid(), damaged, turns=round(SAME_TROUBLE_S / LOOK_S) + 1)
    assert len(caplog.messages) == 2


def test_values_that_are_cut_are_reported_once(caplog: pytest.LogCaptureFixture) -> None:
    watch(parser_of(CONFIGURED), FIRM_PRESSES, turns=round(SAME_TROUBLE_S / LOOK_S) + 1)
    assert caplog.messages == [FIRM]


def test_a_line_that_was_mended_is_told_of_no_more(
    caplog: pytest.LogCaptureFixture, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(line_watch, "SAME_TROUBLE_S", 2 * LOOK_S)
    watch(FabricGrid(), faulty(flip_bit_every=20)[:120] + faulty()[120:540], looks=5)
    assert len(caplog.messages) == 1


def test_frames_that_were_refused_while_the_pad_was_away_are_not_told(
    caplog: pytest.LogCaptureFixture,
) -> None:
    parser = FabricGrid()
    watched = LineWatch(parser, "COM3")
    watched.update(0.0)
    for packet in faulty(flip_bit_every=5):
        parser.feed(packet, 10.0)
    watched.update(3 * LOOK_S)
    assert caplog.messages == []


def test_a_running_sensor_tells_which_port_damages_frames(
    caplog: pytest.LogCaptureFixture, monkeypatch: pytest.MonkeyPatch
) -> None:
    caplog.set_level(logging.WARNING)
    monkeypatch.setattr(line_watch, "LOOK_S", 0.5)
    faults = Faults(flip_bit_every=10)
    numbers = iter(range(1, 10_000))

    def damaged(counts: Counts, sensor_ms: int) -> bytes:
        return faults.on_line(next(numbers), encode_fabric_grid(counts, sensor_ms))

    with FakePort(stream_of(), damaged) as port, sensing(port.path) as queue:
        next_frames(queue, 70)
        (warned,) = caplog.messages
        assert warned.startswith(f"{port.path} at 512000 baud: ")
        assert warned.endswith(f" {TRY}")
