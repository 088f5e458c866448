"""Listens to an unknown pad: at the likeliest baud rate, for a while."""

import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from typing import NamedTuple

import numpy as np

from touchd.drivers.pad.arrived import is_text
from touchd.drivers.pad.format import PRESETS
from touchd.drivers.pad.port import Line, read_waiting
from touchd.drivers.pad.protocol import parser_of
from touchd.drivers.pad.text import ended_at, lines_in, numbers_in
from touchd.drivers.search.binary import frames_in

# The usual baud rates, the likeliest first; 512000 is that of the lab's Mega build.
USUAL_BAUDS = (
    *(115_200, 9_600, 512_000, 1_000_000, 921_600, 460_800, 230_400, 57_600, 38_400, 19_200),
    *(250_000, 500_000, 2_000_000, 3_000_000, 4_000_000),
)
# Opening the port restarts an Arduino, whose boot loader takes two seconds.
FIRST_BYTE_S = 3.0
SAMPLE_S, LONGEST_SAMPLE_S = 0.4, 1.5
SAMPLE_BYTES = 3000
FEW_BYTES = 0.01
SURE = 3.0
# Most bytes that are kept, the latest ones; more than any pad sends in a second.
MOST_BYTES = 1_000_000


class Chunk(NamedTuple):
    """Bytes, and when they arrived (monotonic seconds)."""

    data: bytes
    host_s: float


def listen(
    opened: Line, seconds: float, enough: Callable[[list[Chunk]], bool] = lambda chunks: False
) -> list[Chunk]:
    """Return what arrives within `seconds`, the latest megabyte; raises SensorError when the port goes away.

    enough: called after each chunk; ends listening when true.
    """
    silent = parser_of(PRESETS["fabric-grid"])
    chunks: list[Chunk] = []
    size = 0
    until_s = time.monotonic() + seconds
    while time.monotonic() < until_s:
        if data := read_waiting(opened, silent):
            chunks.append(Chunk(data, time.monotonic()))
            size += len(data)
            while size > MOST_BYTES:
                size -= len(chunks.pop(0).data)
        if enough(chunks):
            break
    return chunks


def likeliest_baud(opened: Line, bauds: Sequence[int], say: Callable[[int], None]) -> int | None:
    """Set the rate at which what arrives looks most like frames, and return it; None if nothing arrives.

    say: called with each rate that is tried.
    """
    first_byte_s = FIRST_BYTE_S
    likely: dict[int, float] = {}
    for baud in bauds:
        say(baud)
        with suppress(OSError, ValueError):
            opened.baudrate = baud
            opened.reset_input_buffer()
            data = _sample(opened, first_byte_s)
            # If one rate yields no bytes, none will.
            if not data and not likely:
                return None
            first_byte_s = LONGEST_SAMPLE_S
            likely[baud] = likelihood(data)
            if likely[baud] >= SURE:
                break
    if not likely:
        return None
    best = max(likely, key=lambda baud: likely[baud])
    opened.baudrate = best
    opened.reset_input_buffer()
    return best


def likelihood(data: bytes) -> float:
    """Rate a sample: text with numbers is certain; next come frames of one length, then single bits."""
    if is_text(data):
        lines = list(lines_in(data[: ended_at(data)]))
        return SURE if any(numbers_in(line)[0] for line in lines) else 2.5
    return 2.0 * (frames_in(data) is not None) + has_single_bits(data) * 0.5


def has_single_bits(data: bytes) -> bool:
    """Whether single bits occur; at twice the pad's baud rate or more, each bit is read at least twice."""
    bits = np.frombuffer(data, dtype=np.uint8)
    edges = (bits ^ bits >> 1) & 0x7F
    return bool(len(data) and np.mean(edges & edges >> 1 > 0) > FEW_BYTES)


def _sample(opened: Line, first_byte_s: float) -> bytes:
    """Return the bytes of a moment: enough to judge them, if the pad sends that many."""
    chunks = listen(opened, first_byte_s, lambda chunks: bool(chunks))
    begun_s = time.monotonic()

    def is_enough(more: list[Chunk]) -> bool:
        size = sum(len(chunk.data) for chunk in more)
        return time.monotonic() - begun_s > SAMPLE_S and size > SAMPLE_BYTES

    chunks += listen(opened, LONGEST_SAMPLE_S, is_enough) if chunks else []
    return b"".join(chunk.data for chunk in chunks)
