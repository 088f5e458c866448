"""From the description of a pad to the parser for it."""

from touchd.drivers.pad.format import PadFormat
from touchd.drivers.pad.parser import FrameParser
from touchd.drivers.pad.text import TextFrames


def parser_of(described: PadFormat) -> FrameParser:
    """Return a parser for what the pad sends."""
    if described.framing == "text":
        return TextFrames(described)
    from touchd.drivers.pad.binary import BinaryFrames, Datagrams

    if described.first_bytes:
        return BinaryFrames(described)
    return Datagrams(described)
