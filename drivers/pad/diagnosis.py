"""Bytes arrive but no frame does: what do they look like, and how would they be described?"""

import json
import math
import re
import string
from collections import Counter, defaultdict
from collections.abc import Iterator
from itertools import pairwise, product
from typing import Any, Literal

import msgspec
import numpy as np

from touchd.drivers.frame import MAX_COUNT
from touchd.drivers.pad.binary import BinaryFrames
from touchd.drivers.pad.clock import MAX_STEP_MS
from touchd.drivers.pad.format import CELL_BITS, PRESETS, PadFormat
from touchd.drivers.pad.protocol import parser_of

# Enough for a diagnosis: several frames of any geometry.
RECENT_BYTES = 32768
LETTERS = frozenset(string.ascii_letters.encode())
LEAST_TEXT_LINES = 3
TEXT = frozenset(b"0123456789,; \t\r\n")
LEAST_FRAMES = 4
LEAST_CELLS = 16
LONGEST_FRAME = 4200
FULL_SCALES = (255, 1023, 4095, 65535)
GRAMS = (2, 3)
MOST_GRAMS = 12
ORDERS: tuple[Literal["little", "big"], ...] = ("big", "little")
CHECKSUMS = ("values", "sum8", "xor8", "none")
COMMONLY = 0.8
# Bytes at twice the baud rate that are damaged in between.
FEW_BYTES = 0.01


def diagnose(data: bytes, expected: PadFormat) -> tuple[str, str]:
    """Say what the last bytes (a few frames' worth) look like when `expected` did not understand them.

    Returns the kind of trouble ("format", "text", "clock", "damage" or "noise") and a sentence for a person.
    """
    parser = parser_of(expected)
    parser.feed(data, 0.0)
    found = propose(data)
    if found is None and _is_text(data):
        line = max(data.decode("ascii", "replace").splitlines()[1:-1], key=len, default="").strip()
        return "text", f"text arrives, such as {line[:40]!r}, and no frame of {expected}"
    is_as_expected = found is not None and str(found) == str(expected)
    if is_as_expected or parser.counts.duplicates + parser.counts.bad_time >= LEAST_FRAMES:
        return "clock", f"frames of {expected} arrive, but their clock stands still or jumps"
    if found is not None:
        return "format", f"looks like {found}, configured {expected}"
    if (numbers := _numbers_a_line(data)) is not None:
        return "format", f"looks like lines of {numbers} numbers, configured {expected}"
    header = expected.first_bytes
    if header and data.count(header) >= LEAST_FRAMES - 1 and len(set(data)) > len(set(header)):
        return "damage", f"frames begin but none of {expected} is whole: bytes lost or damaged on the way?"
    return "noise", f"bytes but no frame of {expected} in them: noise, wrong baud rate?"


def propose(data: bytes) -> PadFormat | None:
    """Return a description that decodes the bytes of an unknown pad; None without one.

    What the bytes cannot show, above all the pad's orientation, keeps its default.
    """
    numbers = _numbers_a_line(data)
    if numbers is None and _is_text(data):
        return None
    guesses = _binaries(data) if numbers is None else _texts(data, numbers)
    # Of zeros every checksum is right.
    checksum_tells = data.count(0) < COMMONLY * len(data)
    for guess in sorted(guesses, key=lambda guess: _plausibility(guess, checksum_tells), reverse=True):
        parser = parser_of(guess)
        frames = parser.feed(data, 0.0)
        parser.reset()
        count = len(frames) + parser.counts.duplicates + parser.counts.bad_time
        is_most = guess.framing != "binary" or count * guess.frame_bytes > len(data) / 2
        if count >= LEAST_FRAMES - 1 and is_most:
            level = np.median([frame.pressure for frame in frames]) if frames else 0
            return _as_preset(msgspec.structs.replace(guess, invert=bool(level > MAX_COUNT / 2)))
    return None


def is_certain(found: PadFormat) -> bool:
    """Whether bytes read at a wrong baud rate cannot look so: text, a known line, a clock that counts."""
    return found.framing != "binary" or _is_known(found) or found.clock


def has_single_bits(data: bytes) -> bool:
    """Whether single bits occur; at twice a pad's baud rate or more there are none, each is read twice."""
    bits = np.frombuffer(data, dtype=np.uint8)
    edges = (bits ^ bits >> 1) & 0x7F
    return bool(np.mean(edges & edges >> 1 > 0) > FEW_BYTES)


def _plausibility(guess: PadFormat, checksum_tells: bool) -> float:
    """Rate a guess: a preset's line is known; a checksum or clock that fits is hardly an accident; pads are
    mostly square; a long header is cells."""
    square = min(guess.rows, guess.columns) / max(guess.rows, guess.columns)
    header = len(guess.first_bytes)
    return (
        5 * _is_known(guess)
        + 3 * (guess.checksum != "none" and checksum_tells)
        + 2 * guess.clock
        + 2 * square
        + 0.5 * (guess.cell == "u16")
        # Guessed only where a line without numbers ends each frame.
        + 3 * (guess.framing == "text" and guess.end != "")
        - 0.05 * abs(header - 3)
        # Untouched cells beside the header look like a part of it.
        - 0.2 * guess.first_bytes.count(0)
        # Cells read from a wrong offset look larger.
        - 0.1 * FULL_SCALES.index(guess.full_scale)
    )


def _is_known(guess: PadFormat) -> bool:
    return guess.framing == "binary" and any(preset.line == guess.line for preset in PRESETS.values())


def as_yaml(described: PadFormat) -> str:
    """Return a description as it stands in the configuration, on one line."""
    for name, preset in PRESETS.items():
        if preset == described:
            return f"format: {name}"
    fields = msgspec.to_builtins(described)
    return f"format: {{{', '.join(f'{key}: {json.dumps(value)}' for key, value in fields.items())}}}"


def caution(proposed: PadFormat) -> str:
    """Return what to check in a proposal, "" if nothing: a pad at rest shows neither range nor sides."""
    if proposed in PRESETS.values():
        return ""
    parts = []
    if not proposed.end and proposed.rows != proposed.columns:
        parts.append(f"{proposed.cells} cells came: how many rows and columns is a guess")
    if proposed.framing != "binary" or proposed.cell != "u8":
        parts.append("full_scale is a guess from the largest value seen: set what a cell can send at most")
    if proposed.checksum in ("values", "sum8") and proposed.cell == "u16" and proposed.full_scale < 256:
        parts.append("checksum may be values or sum8: press the pad firmly while the doctor listens")
    return "; ".join(parts)


def _as_preset(guess: PadFormat) -> PadFormat:
    """Return the preset with the same line and grid, which knows border and range; else the guess itself."""
    alike = [preset for preset in PRESETS.values() if str(preset) == str(guess)]
    # A text of numbers says less of its pad than a header does.
    is_told = guess.framing == "binary"
    same = (
        p for p in alike if p.full_scale == guess.full_scale or (is_told and p.full_scale > guess.full_scale)
    )
    return next(same, guess)


def _sides(cells: int) -> tuple[int, int] | None:
    """Return rows and columns as near to a square as these many cells allow; None when they are no grid."""
    for rows in range(math.isqrt(cells), 3, -1):
        if cells % rows == 0 and cells // rows <= 32:
            return rows, cells // rows
    return None


def _full_scale(largest: int) -> int:
    return next(scale for scale in FULL_SCALES if largest <= scale or scale == FULL_SCALES[-1])


def _is_text(data: bytes) -> bool:
    """Whether these are lines of words, as a board's log writes them."""
    letters = sum(byte in LETTERS for byte in data)
    return data.count(b"\n") >= LEAST_TEXT_LINES and letters >= 0.2 * len(data) and data.isascii()


def _numbers_a_line(data: bytes) -> int | None:
    """Return how many numbers most lines of a text of numbers hold; None when it is no such text."""
    lines = [line for line in data.split(b"\n")[1:-1] if line.strip()]
    if len(lines) < LEAST_FRAMES - 1 or sum(byte in TEXT for byte in data) < 0.9 * len(data):
        return None
    return Counter(len(_numbers(line)) for line in lines).most_common(1)[0][0]


def _numbers(line: bytes) -> list[int]:
    # Python refuses to read thousands of digits; a pad's numbers have at most ten.
    return [int(digits[:20]) for digits in re.findall(rb"\d+", line)]


def _texts(data: bytes, numbers: int) -> Iterator[PadFormat]:
    """Yield formats for lines of so many numbers."""
    lines = data.split(b"\n")[1:-1]
    rows_of = [row for row in map(_numbers, lines) if len(row) == numbers]
    # The first number of a line may be a clock.
    scale = _full_scale(max(max(row[1:], default=0) for row in rows_of))
    for cells in (numbers, numbers - 1):
        known = [(preset.rows, preset.columns) for preset in PRESETS.values() if preset.cells == cells]
        sides = known[0] if known else _sides(cells) if cells >= LEAST_CELLS else None
        if sides is not None and (known or cells == numbers or sides[0] == sides[1]):
            skip = numbers - cells
            yield PadFormat(framing="text", skip=skip, rows=sides[0], columns=sides[1], full_scale=scale)
    between = [line.strip() for line in lines if not _numbers(line)]
    if between and 4 <= numbers <= 32:
        (end, ends), *_ = Counter(between).most_common(1)
        rows = round(len(rows_of) / ends)
        if 4 <= rows <= 32 and end.isascii():
            yield PadFormat(framing="text", rows=rows, columns=numbers, full_scale=scale, end=end.decode())


def _binaries(data: bytes) -> Iterator[PadFormat]:
    for header in _headers_of(data):
        starts = [match.start() for match in re.finditer(b"(?=%s)" % re.escape(header), data)]
        size, times = Counter(later - earlier for earlier, later in pairwise(starts)).most_common(1)[0]
        windows = [
            data[at : at + size] for at in starts if data[at + size : at + size + len(header)] == header
        ]
        is_all = times * size >= COMMONLY * (len(data) - 2 * size)
        if times < LEAST_FRAMES - 1 or not is_all or not LEAST_CELLS < size <= LONGEST_FRAME:
            continue
        for clock, checksum, cell in product((True, False), CHECKSUMS, ("u8", "u12", "u16")):
            bits = 8 * (size - len(header) - 4 * clock - (checksum != "none"))
            sides = _sides(bits // CELL_BITS[cell]) if bits > 0 and bits % CELL_BITS[cell] == 0 else None
            for order in ORDERS if cell != "u8" or clock else ORDERS[1:]:
                fields: dict[str, Any] = {"clock": clock, "checksum": checksum, "cell": cell, "order": order}
                if sides is not None:
                    yield from _fitting(windows, header, fields | {"rows": sides[0], "columns": sides[1]})


def _fitting(windows: list[bytes], header: bytes, fields: dict[str, Any]) -> Iterator[PadFormat]:
    """Yield the format with these fields when most of the windows that begin with its header are sound."""
    bits = CELL_BITS[fields["cell"]]
    loose = PadFormat(header=header.hex(), full_scale=(1 << bits) - 1, **fields)
    reader = BinaryFrames(loose)
    largest = int(np.median([reader.values_in(window).max() for window in windows]))
    if bits == 16 and largest > FULL_SCALES[2]:
        return
    sound = sum(reader.damage_in(window) in (None, "bad_framing") for window in windows)
    steps = [later - earlier for earlier, later in pairwise(map(reader.time_in, windows))]
    is_clock = sum(0 < step <= MAX_STEP_MS for step in steps) >= COMMONLY * len(steps)
    # A known line with a checksum is no accident: its clock may be what is wrong.
    if loose.clock and not is_clock and not (_is_known(loose) and loose.checksum != "none"):
        return
    if sound >= COMMONLY * len(windows):
        top = max(
            int(reader.values_in(window).max()) for window in windows if reader.damage_in(window) is None
        )
        yield msgspec.structs.replace(loose, full_scale=_full_scale(top))


def _headers_of(data: bytes) -> list[bytes]:
    """Return what may be the header: those of the presets, and bytes that come again at one distance."""
    places: defaultdict[bytes, list[int]] = defaultdict(list)
    for length, at in product(GRAMS, range(len(data))):
        places[data[at : at + length]].append(at)
    scored: list[tuple[float, bytes]] = []
    for gram, seen in places.items():
        if len(seen) >= LEAST_FRAMES:
            spacing, times = Counter(later - earlier for earlier, later in pairwise(seen)).most_common(1)[0]
            if LEAST_CELLS < spacing <= LONGEST_FRAME:
                # The one with the fewest strays, for a header is nowhere else.
                scored.append((times**2 * spacing / len(seen), gram))
    found = {
        preset.first_bytes
        for preset in PRESETS.values()
        if data.count(preset.first_bytes or data) >= LEAST_FRAMES
    }
    for _, gram in sorted(scored, reverse=True)[:MOST_GRAMS]:
        found.add(gram)
        after = Counter(data[at : at + len(gram) + 1] for at in places[gram]).most_common(1)[0]
        if after[1] >= COMMONLY * len(places[gram]):
            found.add(after[0])
    return sorted(found)
