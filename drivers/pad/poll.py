"""Asks a pad for a frame that it sends only when it is asked."""

import os
import time
from contextlib import suppress

import serial

from touchd.drivers.pad.binary import BinaryFrames
from touchd.drivers.pad.parser import FrameParser
from touchd.drivers.pad.port import READ_TIMEOUT_S, Line


def ask(opened: Line, parser: FrameParser) -> None:
    """Ask for the next frame, if it is due before the next read."""
    assert isinstance(parser, BinaryFrames), "only a binary format has a poll"
    wait_s = parser.ask_in_s(time.monotonic())
    if wait_s > READ_TIMEOUT_S:
        return
    time.sleep(wait_s)
    # A late reply to the previous poll must not become half of the next.
    opened.reset_input_buffer()
    parser.ask(time.monotonic())
    poll = bytes.fromhex(parser.format.poll)
    if type(opened) is not serial.Serial:
        opened.write(poll)
        return
    # pyserial's own write waits, without end, for a board that does not read.
    with suppress(BlockingIOError):
        os.write(opened.fileno(), poll)
