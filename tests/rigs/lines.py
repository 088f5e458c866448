"""Makes the lines in tests/recordings, each by a function: the bytes of a pad, and what damages them."""

import gzip
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import NamedTuple

import msgspec
import numpy as np
from numpy.random import RandomState
from numpy.typing import NDArray
from rigs.streams import frames_of, hand, nothing, sent

from touchd.drivers.fakes.encode import encode_values
from touchd.drivers.frame import FRAME_RATE_HZ
from touchd.drivers.pad.format import PRESETS, PadFormat

Values = NDArray[np.float64]


class Piece(NamedTuple):
    """Bytes that arrive together. at_ms: when. data: None where the port is opened again."""

    at_ms: int
    data: bytes | None


class Line(NamedTuple):
    """What a pad of a format sends."""

    described: PadFormat
    pieces: list[Piece]


LINES: dict[str, Callable[[], Line]] = {}
SMALL = PadFormat(header="aa55", clock="ms", cell="u8", rows=8, columns=8, full_scale=255, checksum="sum8")


def line(made: Callable[[], Line]) -> Callable[[], Line]:
    """Register a line under its function's name; the function's docstring is its title."""
    LINES[made.__name__.replace("_", "-")] = made
    return made


def write_line(path: Path, made: Line, title: str) -> None:
    """Write a line: its title and format, then a piece a row, as its time in ms and its bytes in hex."""
    described = msgspec.json.encode(made.described).decode()
    rows = [f"{at_ms},{'reopened' if data is None else data.hex()}" for at_ms, data in made.pieces]
    text = "\n".join([f"# title: {title}", f"# format: {described}", *rows, ""])
    path.write_bytes(gzip.compress(text.encode(), mtime=0))


def read_line(path: Path) -> Line:
    """Read what `write_line` wrote."""
    header: dict[str, str] = {}
    pieces: list[Piece] = []
    for row in gzip.decompress(path.read_bytes()).decode().splitlines():
        if row.startswith("# "):
            key, _, value = row[2:].partition(": ")
            header[key] = value
            continue
        at_ms, _, data = row.partition(",")
        pieces.append(Piece(int(at_ms), None if data == "reopened" else bytes.fromhex(data)))
    return Line(msgspec.json.decode(header["format"], type=PadFormat), pieces)


def touched(described: PadFormat, pressed: Values, seed: int = 1) -> Values:
    """Return (T, rows, columns) values of a pad under a pressure (T, 8, 8), at its own full scale."""
    counts = sent(pressed, seed).counts
    down, right = (np.arange(side) * 8 // side for side in (described.rows, described.columns))
    values: Values = counts[:, down[:, None], right] * (described.full_scale / 1023.0)
    if described.invert:
        values = described.full_scale - values
    return values if described.cell == "f32" else np.rint(values)


def clock_of(frames: int, first_ms: int = 0) -> list[int]:
    return [first_ms + round(1000 * number / FRAME_RATE_HZ) for number in range(frames)]


def packets(described: PadFormat, values: Values, first_ms: int = 1000) -> Iterator[tuple[int, bytes]]:
    """Yield when each frame is sent, and its bytes."""
    kind = np.float32 if described.cell == "f32" or described.framing == "text" else np.int32
    for at_ms, frame in zip(clock_of(len(values), first_ms), values, strict=True):
        yield at_ms - first_ms, encode_values(described, frame.astype(kind), at_ms)


def one_each(described: PadFormat, values: Values) -> Line:
    """Return a line on which each frame arrives by itself."""
    return Line(described, [Piece(*packet) for packet in packets(described, values)])


def stroked(described: PadFormat, lead_s: float = 2.2) -> Values:
    return touched(described, hand(31, ("stroke", 2.9), lead_s=lead_s, quiet_s=1.2))


def patted(described: PadFormat, lead_s: float = 2.2) -> Values:
    return touched(described, hand(32, ("pat", 2.9), lead_s=lead_s, quiet_s=1.2))


# Formats.


@line
def line_of_the_fabric_pad() -> Line:
    """The fabric pad's frames come in pieces of 64 bytes; it is stroked."""
    described = PRESETS["fabric-grid"]
    pieces = [
        Piece(at_ms + place // 64, data[place : place + 64])
        for at_ms, data in packets(described, stroked(described))
        for place in range(0, len(data), 64)
    ]
    return Line(described, pieces)


@line
def line_of_floats() -> Line:
    """A 6x6 pad sends floats, in every twentieth frame one that is no number or infinite; it is patted."""
    described = PadFormat(header="f00df00d", cell="f32", rows=6, columns=6, full_scale=3.3)
    values = patted(described)
    values[10::40, 2, 3], values[30::40, 2, 3] = np.nan, np.inf
    return one_each(described, values)


@line
def line_of_signed_cells() -> Line:
    """A 4x8 pad sends signed cells, most of them below zero at rest; it is stroked."""
    described = PadFormat(
        header="ab", footer="cd", cell="i16", order="big", rows=4, columns=8, full_scale=2000
    )
    return one_each(described, stroked(described) - 12)


@line
def line_of_packed_cells() -> Line:
    """A pad packs two cells of 12 bits in three bytes; it is patted."""
    described = PadFormat(header="5a5aa5", cell="u12", rows=8, columns=8, full_scale=4095, checksum="xor8")
    return one_each(described, patted(described))


@line
def line_of_rows_of_text() -> Line:
    """A pad prints a row a line with its number, and a word between frames; it is stroked."""
    described = PadFormat(framing="text", rows=8, columns=8, skip=1, end="done")
    return one_each(described, stroked(described))


@line
def line_of_text_with_the_time_of_day() -> Line:
    """A pad prints a line a frame, led by the milliseconds since 1970, more than 32 bits; it is patted."""
    described = PadFormat(framing="text", rows=6, columns=6, skip=1, clock="ms")
    first_ms = 1_790_000_000_000
    pieces = [
        Piece(at_ms, b"%d,%s" % (first_ms + at_ms, data.partition(b",")[2]))
        for at_ms, data in packets(described, patted(described))
    ]
    return Line(described, pieces)


@line
def line_of_text_with_seconds() -> Line:
    """A pad prints a line a frame, led by seconds with a fraction; lines end in CR alone; it is stroked."""
    described = PadFormat(framing="text", rows=6, columns=6, skip=1, clock="s")
    pieces = [
        Piece(at_ms, b"%.3f %s\r" % (at_ms / 1000, data.partition(b",")[2].strip().replace(b",", b" ")))
        for at_ms, data in packets(described, stroked(described))
    ]
    return Line(described, pieces)


@line
def line_of_text_with_frame_numbers() -> Line:
    """A pad prints a line a frame, led by the frame's number instead of a clock; it is patted."""
    described = PadFormat(framing="text", rows=6, columns=6, skip=1)
    pieces = [
        Piece(at_ms, b"%d,%s" % (number, data.partition(b",")[2]))
        for number, (at_ms, data) in enumerate(packets(described, patted(described)))
    ]
    return Line(described, pieces)


# Damage.


@line
def damage_flipped_bits() -> Line:
    """Long wires flip a bit in every twelfth frame; a stroke is still recognised."""
    rng = RandomState(41)
    pieces = []
    for number, (at_ms, data) in enumerate(packets(SMALL, stroked(SMALL, lead_s=11.0))):
        damaged = bytearray(data)
        if number % 12 == 5:
            damaged[rng.randint(6, len(data))] ^= 1 << rng.randint(8)
        pieces.append(Piece(at_ms, bytes(damaged)))
    return Line(SMALL, pieces)


@line
def damage_lost_bytes() -> Line:
    """In every fifteenth frame some bytes are lost; a pat goes on."""
    rng = RandomState(42)
    pieces = []
    for number, (at_ms, data) in enumerate(packets(SMALL, patted(SMALL))):
        cut = rng.randint(1, len(data) - 4)
        pieces.append(Piece(at_ms, data[:cut] + data[cut + 3 :] if number % 15 == 7 else data))
    return Line(SMALL, pieces)


@line
def damage_reopened_port() -> Line:
    """The port goes in the middle of a frame in a rub, and is opened again in the middle of another."""
    described = PadFormat(framing="text", rows=8, columns=8, skip=1, clock="ms")
    values = touched(described, hand(33, ("rub", 4.5), lead_s=2.2, quiet_s=1.2))
    pieces = [Piece(*packet) for packet in packets(described, values)]
    place = frames_of(3.6)
    (cut_ms, cut), (again_ms, again) = pieces[place], pieces[place + 5]
    gap = [Piece(cut_ms, cut[:40]), Piece(again_ms - 1, None), Piece(again_ms, again[60:])]  # type: ignore[index]
    return Line(described, [*pieces[:place], *gap, *pieces[place + 6 :]])


@line
def damage_boot_text() -> Line:
    """A binary pad prints its boot loader's text first, and restarts with it in a stroke."""
    boot = b"ets Jul 29 2019 12:21:46\r\nrst:0x1 (POWERON_RESET),boot:0x13\r\n\xaa\x55\xaa"
    pieces = [Piece(0, boot)]
    begun_ms = 0
    for at_ms, frame in zip(clock_of(400), stroked(SMALL).tolist() * 2, strict=False):
        if at_ms >= 4200 and not begun_ms:
            begun_ms = at_ms
            pieces.append(Piece(at_ms, boot))
        pieces.append(Piece(at_ms, encode_values(SMALL, np.array(frame, np.int32), at_ms - begun_ms)))
    return Line(SMALL, pieces)


@line
def damage_held_up() -> Line:
    """The line is held up for 0.7 s in a pat, and then all its frames arrive at once."""
    pieces = [
        Piece(4100 if 3400 <= at_ms < 4100 else at_ms, data) for at_ms, data in packets(SMALL, patted(SMALL))
    ]
    return Line(SMALL, pieces)


@line
def damage_clock_jumps() -> Line:
    """In every tenth frame the clock's upper byte is wrong, though the checksum fits; a stroke goes on."""
    values = stroked(SMALL)
    pieces = [
        Piece(at_ms, encode_values(SMALL, frame.astype(np.int32), at_ms + (number % 10 == 4) * 0x0100_0000))
        for number, (at_ms, frame) in enumerate(zip(clock_of(len(values)), values, strict=True))
    ]
    return Line(SMALL, pieces)


@line
def damage_header_among_cells() -> Line:
    """A header of one byte occurs among the cells, and some frames are cut; a stroke goes on."""
    described = PadFormat(header="10", cell="u8", rows=8, columns=8, full_scale=255)
    values = stroked(described)
    values[:, 1, 1] = 0x10
    pieces = [
        Piece(at_ms, data[: 50 if number % 25 == 12 else None])
        for number, (at_ms, data) in enumerate(packets(described, values))
    ]
    return Line(described, pieces)


@line
def damage_above_full_scale() -> Line:
    """A hand exceeds the configured full scale; its values are cut to it."""
    described = PadFormat(framing="text", rows=6, columns=6, full_scale=100)
    values = touched(described, np.tile(hand(34, ("constant", 5.0), lead_s=0.5, quiet_s=1.0), (2, 1, 1)))
    return one_each(described, 25 * values)


@line
def damage_cut_lines_of_text() -> Line:
    """Characters are lost in every ninth line of text, so that numbers run together; a pat goes on."""
    described = PadFormat(framing="text", rows=6, columns=6)
    pieces = [
        Piece(at_ms, data[:30] + data[40:] if number % 9 == 4 else data)
        for number, (at_ms, data) in enumerate(packets(described, patted(described)))
    ]
    return Line(described, pieces)


@line
def damage_nothing_but_noise() -> Line:
    """Random bytes arrive: no frame, no touch."""
    rng = RandomState(43)
    return Line(SMALL, [Piece(at_ms, rng.bytes(64)) for at_ms in clock_of(len(nothing(4.0)))])
