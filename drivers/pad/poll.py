"""Asks a pad for a frame that it sends only when it is asked."""

import time

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
    opened.write(bytes.fromhex(parser.format.poll))
