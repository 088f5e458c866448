"""From the description of a pad to the parser for it."""

from touchd.drivers.pad.binary import BinaryFrames, Replies
from touchd.drivers.pad.format import PadFormat
from touchd.drivers.pad.parser import FrameParser
from touchd.drivers.pad.text import TextFrames


def parser_of(described: PadFormat) -> FrameParser:
    """Return a parser for what the pad sends."""
    if described.framing != "binary":
        return TextFrames(described)
    return BinaryFrames(described) if described.first_bytes else Replies(described)
