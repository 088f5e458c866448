"""Listens to an unknown pad: at the likeliest baud rate, for a while."""

import re
import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from typing import NamedTuple

import numpy as np

from touchd.drivers.pad.port import Port, discard_input, read_waiting
from touchd.drivers.search.binary import tables
from touchd.drivers.search.text import is_text

# The usual baud rates, the likeliest first; 512000 is that of the lab's Mega build.
USUAL_BAUDS = (
    *(115_200, 9_600, 512_000, 1_000_000, 921_600, 460_800, 230_400, 57_600, 38_400, 19_200),
    *(250_000, 500_000, 2_000_000, 3_000_000, 4_000_000),
)
# Opening the port restarts an Arduino, whose boot loader takes two seconds.
FIRST_BYTE_S = 3.0
# A second shows the eight frames of the slowest pad.
SAMPLE_S = 1.0
# More than half of random bytes have an isolated bit. At too high a rate, line noise alone makes a few.
FEW_BYTES = 0.01
# Only the latest bytes are kept; eight seconds of the largest preset take a fifth of this.
MOST_BYTES = 1_000_000


class Chunk(NamedTuple):
    """Bytes, and when they arrived (monotonic seconds)."""

    data: bytes
    host_s: float


def seconds_of(chunks: Sequence[Chunk]) -> float:
    """Return how long chunks took to arrive, from the first on."""
    return max(chunks[-1].host_s - chunks[0].host_s, 1e-3)


def listen(
    opened: Port, seconds: float, enough: Callable[[list[Chunk]], bool] = lambda chunks: False
) -> list[Chunk]:
    """Return what arrives within `seconds`; raises SensorError when the port goes away.

    enough: called before each read; ends listening when true.
    """
    chunks: list[Chunk] = []
    until_s = time.monotonic() + seconds
    while time.monotonic() < until_s and not enough(chunks):
        if data := read_waiting(opened):
            chunks.append(Chunk(data, time.monotonic()))
    return chunks


def likeliest_baud(opened: Port, bauds: Sequence[int], say: Callable[[int], None]) -> int | None:
    """Set the rate at which what arrives looks most like frames, and return it; None if nothing arrives.

    say: called with each rate that is tried.
    """
    likely: dict[int, tuple[bool, bool, bool]] = {}
    for baud in bauds:
        say(baud)
        with suppress(OSError, ValueError):
            opened.baudrate = baud
            discard_input(opened)
            chunks = listen(opened, FIRST_BYTE_S, bool)
            # If one rate yields no bytes, none will.
            if not chunks and not likely:
                return None
            likely[baud] = likelihood(b"".join(chunk.data for chunk in chunks + listen(opened, SAMPLE_S)))
            if likely[baud][0]:
                break
    best = max(likely, key=lambda baud: likely[baud], default=None)
    if best is not None:
        opened.baudrate = best
        discard_input(opened)
    return best


def likelihood(data: bytes) -> tuple[bool, bool, bool]:
    """Rate a sample: text with digits is certain; next come frames of one length, then isolated bits.

    At twice the pad's baud rate or more, each bit is read at least twice, so that none is isolated.
    """
    is_printed = is_text(data) and re.search(rb"\d", data) is not None
    values = np.frombuffer(data, dtype=np.uint8)
    edges = (values ^ values >> 1) & 0x7F
    has_single_bits = np.count_nonzero(edges & edges >> 1) > FEW_BYTES * len(data)
    return is_printed, next(tables(data), None) is not None, bool(has_single_bits)
