"""Bytes arrive but no frame does: what do they look like?"""

from __future__ import annotations

import math
import re
from collections import Counter
from itertools import pairwise

from drivers.pad.fabric_grid import damage_in, frame_bytes

# A header, and a clock and a value that may begin with FF; a longer run of FF is an idle or broken line.
HEADER = re.compile(rb"(?<!\xff)\xff{4,9}(?!\xff)")
TEXT = frozenset(b"0123456789,; \t\r\n")
LEAST_HEADERS = 3


def diagnose(data: bytes, expected: str) -> tuple[str, str]:
    """Say what the last bytes (a few frames' worth) look like when `expected` did not understand them.

    Returns the kind of trouble ("format", "clock", "damage" or "noise") and a sentence for a person.
    """
    starts = [match.start() for match in HEADER.finditer(data)]
    found = _lines_in(data) or _fabric_grid_in(data, starts)
    if found == expected:
        return "clock", f"frames of {expected} arrive, but their clock stands still or jumps"
    if found:
        return "format", f"looks like {found}, configured {expected}"
    if len(starts) < LEAST_HEADERS:
        return "noise", f"bytes but no frame of {expected} in them: noise, wrong baud rate?"
    return "damage", f"frames begin but none of {expected} is whole: bytes lost or damaged on the way?"


def _lines_in(data: bytes) -> str:
    """Return what kind of lines of numbers this is, "" when it is not that."""
    lines = data.split(b"\n")[1:-1]
    if len(lines) < LEAST_HEADERS or sum(byte in TEXT for byte in data) < 0.95 * len(data):
        return ""
    numbers = Counter(len(re.findall(rb"\d+", line)) for line in lines).most_common(1)[0][0]
    side = math.isqrt(numbers)
    with_clock = numbers == side * side + 1
    return f"csv {side}x{side}" if numbers == side * side or with_clock else f"lines of {numbers} numbers"


def _fabric_grid_in(data: bytes, starts: list[int]) -> str:
    """Return the geometry of the sound frames that lie between the headers, "" when there is none."""
    if len(starts) < LEAST_HEADERS:
        return ""
    spacing = Counter(later - earlier for earlier, later in pairwise(starts)).most_common(1)[0][0]
    taxels = (spacing - frame_bytes(0)) // 2
    if taxels <= 0 or frame_bytes(taxels) != spacing:
        return ""
    windows = [data[start : start + spacing] for start in starts if start + spacing <= len(data)]
    if 2 * sum(damage_in(window) is None for window in windows) < len(windows):
        return ""
    side = math.isqrt(taxels)
    return f"fabric-grid {side}x{side}" if side * side == taxels else f"fabric-grid of {taxels} taxels"
