"""Pads on a pty for the doctor."""

import os
import termios
from typing import Any

import numpy as np
from rigs.formats import encode_fabric_grid
from rigs.line_faults import NO_FAULTS, Faults
from rigs.sensor_rig import Encode, noise
from rigs.wire import read_too_fast

from touchd.daemon.app.config import Settings
from touchd.daemon.doctor.check import Sample
from touchd.drivers.fakes.encode import encode_frame
from touchd.drivers.fakes.fake_port import FakePort
from touchd.drivers.frame import Counts, Frame
from touchd.drivers.pad.format import PadFormat
from touchd.drivers.pad.parser import FrameParser
from touchd.drivers.recording import Stream, ideal_clock_ms
from touchd.model.studies.simulated import simulate

SETTINGS = Settings()


def resting(seconds: float = 8.0) -> Counts:
    """Return counts of an intact, untouched pad."""
    (recording,) = simulate((("notouch", seconds),), seed=3)
    return np.array(recording.counts)


def pad_of(counts: Counts, encode: Encode = encode_fabric_grid, **options: Any) -> FakePort:
    """A pad that sends these counts at 54 Hz."""
    return FakePort(Stream(counts, ideal_clock_ms(len(counts)), ()), encode, **options)


def pad_at_baud(
    counts: Counts,
    speed: int,
    encode_right: Encode = encode_fabric_grid,
    encode_wrong: Encode = noise,
    pace: float = 4.0,
) -> FakePort:
    """A pad that sends noise unless its line is set to this termios speed."""

    def encode(counts: Counts, sensor_ms: int) -> bytes:
        line = os.open(port.path, os.O_RDWR | os.O_NOCTTY)
        is_right = termios.tcgetattr(line)[5] == speed
        os.close(line)
        return (encode_right if is_right else encode_wrong)(counts, sensor_ms)

    port = pad_of(counts, encode, speed=pace, loop=True)
    return port


def pad_read_too_fast(counts: Counts, speed: int, described: PadFormat, pace: float = 4.0) -> FakePort:
    """A pad whose bytes are read at twice its baud rate unless its line is set to this termios speed."""

    def encode(counts: Counts, sensor_ms: int) -> bytes:
        return encode_frame(described, counts, sensor_ms)

    return pad_at_baud(counts, speed, encode, lambda *sent: read_too_fast(encode(*sent), 2), pace)


def sample(counts: Counts, faults: Faults = NO_FAULTS) -> Sample:
    """Return what the doctor reads of these counts, sent at 54 Hz."""
    parser, frames = FrameParser(SETTINGS.sensor.described), list[Frame]()
    for number, scan in enumerate(counts):
        sent = encode_fabric_grid(scan, round(1000 * number / 54))
        frames += parser.feed(faults.on_line(number, sent), number / 54)
    return Sample(tuple(frames), parser.counts.bad, b"", frames[-1].host_s)
