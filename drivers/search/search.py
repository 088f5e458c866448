"""Finds the description of a pad in its bytes, and proves it; or says what arrived and what is missing."""

import json
import math
from collections.abc import Sequence
from dataclasses import dataclass
from heapq import nsmallest
from typing import NamedTuple

import msgspec
import numpy as np
from msgspec.structs import replace

from touchd.drivers.frame import MAX_COUNT
from touchd.drivers.pad.arrived import is_text, looks_like
from touchd.drivers.pad.binary import frame_bytes
from touchd.drivers.pad.format import CELL_TOP, PRESETS, PadFormat, layout_of
from touchd.drivers.pad.protocol import parser_of
from touchd.drivers.search import binary, text
from touchd.drivers.search.coupling import KINDS, NOT_TOGETHER, TOO_LITTLE, Movement, Numbers, objection
from touchd.drivers.search.text import Guess

# Most bytes that a search uses, the latest ones; more than any pad sends in a second.
MOST_BYTES = 1_000_000
EXPLAINED = 0.98
SLOWEST_HZ, FASTEST_HZ = 9.5, 525.0
# Frames come evenly if no part of the time has fewer or more than its share by this factor.
PARTS = 8
UNEVEN = 3.0
# A pad that sends nothing for this long sends only while it is pressed.
LONGEST_PAUSE_S = 1.5
FULL_SCALES = (1023, 4095, 65535)
# A configuration takes no larger full_scale; a parser cannot divide by a smaller one.
SMALLEST_SCALE, LARGEST_SCALE = 1e-30, 4e9
# The full scale of numbers with a fraction is one of these, times a power of ten.
ROUND = (1, 2, 5)
MOSTLY = 0.9
NO_FRAMES_IN_TEXT = (
    "no steady frames of 16 numbers or more, 10 to 500 a second; print each frame in a line, or end it with "
    "an empty line"
)
NO_FRAMES_IN_BYTES = (
    "no frames of one length: a wrong baud rate, no header, or nothing presses the pad while I listen"
)
MOST_RANKED = 40
# A grid that leaves out numbers that a hand moves must be this many times as good as one that does not.
MISFIT_GAIN = 1.15
# In the wrong byte order, cells change this many times as much when their upper byte steps.
SHIFTED = 1.2
# A right checksum decides between grids of nearly the same score.
NEAR = 0.85


# A press must move a cell by this many counts of the model's scale: less is detected, but not recognised.
LEAST_PRESS = 16.0

TIED = "both explain what came equally well"
CUT = "a hand moves numbers beside its cells, too"
SHORT = (
    "numbers beside its cells may be a row or column that does not move, or the end of a frame: press all "
    "over it, mend it, or print equally many numbers on each line"
)
PRESSED_LONG = (
    "its numbers rest on the wrong side of their range for the way in which a hand seems to move them: let "
    "go of the pad between presses"
)
# After these, comparing contacts may still prove a grid; after UNSURE ones, a longer recording may.
BY_CONTACT = (TIED, NOT_TOGETHER, TOO_LITTLE, PRESSED_LONG)
UNSURE = (*BY_CONTACT, KINDS)


class Chunk(NamedTuple):
    """Bytes, and when they arrived (monotonic seconds)."""

    data: bytes
    host_s: float


@dataclass(frozen=True)
class Finding:
    """What a search found.

    proposed: the description, if it is proven. likely: at most two descriptions that may be right, the best
    first. missing: why nothing is proposed, "" if something is. saw: what arrived, in words.
    """

    proposed: PadFormat | None
    likely: tuple[PadFormat, ...]
    missing: str
    saw: str

    def __str__(self) -> str:
        return "; ".join(part for part in (self.saw, self.advice) if part)

    @property
    def advice(self) -> str:
        """What it may be, and what is missing."""
        likely = " or ".join(as_yaml(each) for each in self.likely)
        return "; ".join(part for part in (likely and f"perhaps {likely}", self.missing) if part)


def search(chunks: Sequence[Chunk]) -> Finding:
    """Search for the description of an unknown pad in its bytes."""
    kept = _latest(chunks)
    data = b"".join(chunk.data for chunk in kept)
    if not data:
        return Finding(None, (), "is it the pad's port, and does the pad run?", "nothing arrives")
    seconds = max(kept[-1].host_s - kept[0].host_s, 1e-3)
    arrived = _Arrived(
        chunks=kept,
        data=data,
        times_s=np.repeat([chunk.host_s for chunk in kept], [len(chunk.data) for chunk in kept]),
        seconds=seconds,
        saw=f"{len(data) / seconds:.0f} bytes/s of {looks_like(data)}",
        lines=text.lines_of(data) if _is_printed(data) else None,
    )
    finding = _searched(arrived, by_contact=False)
    if finding.missing in BY_CONTACT and arrived.lines is not None:
        by_contact = _searched(arrived, by_contact=True)
        return finding if by_contact.proposed is None else by_contact
    return finding


@dataclass(frozen=True)
class _Arrived:
    """What arrived. times_s: when each byte arrived. saw: what it is, in words. lines: those of a text."""

    chunks: Sequence[Chunk]
    data: bytes
    times_s: Numbers
    seconds: float
    saw: str
    lines: Sequence[text.Line] | None


def _searched(arrived: _Arrived, by_contact: bool) -> Finding:
    """Search, with one measure of what moves together: movement, or contact."""
    data, seconds, saw = arrived.data, arrived.seconds, arrived.saw
    printed = arrived.lines is not None

    def nothing(missing: str, likely: Sequence[Guess] = ()) -> Finding:
        return Finding(None, tuple(_finished(each) for each in likely), missing, saw)

    if not printed and binary.is_cobs(data):
        return nothing("COBS frames: send plain cells after a header of two bytes")
    if arrived.lines is not None and (wrong := text.unreadable(arrived.lines)):
        return nothing(wrong)
    found = binary.guesses(data) if arrived.lines is None else text.guesses(arrived.lines, by_contact)
    paced = [each for each in found if SLOWEST_HZ <= len(each.values) / seconds <= FASTEST_HZ]
    ranked = nsmallest(MOST_RANKED, [each for each in paced if each.is_folded] or paced, key=_rank)
    if not ranked:
        return nothing(NO_FRAMES_IN_TEXT if printed else NO_FRAMES_IN_BYTES)
    ranked = [each for each in ranked if not any(_is_shifted(each, other) for other in ranked)]
    # What a hand moves is a cell, unless a grid without it is surely better.
    best = min((each for each in ranked if not ranked[0].fold.beats(each.fold)), key=_misfits)
    wanting = objection(best.values, best.described.rows, best.described.columns, by_contact)
    wanting = wanting or (CUT if best.is_cut else "" if best.is_folded else NOT_TOGETHER)
    wanting = wanting or (SHORT if best.is_short else "")
    if not printed:
        ranked = _confirmed(ranked, data, arrived.times_s)
        best = ranked[0] if best not in ranked else best
    ties = [each for each in ranked if not (_is_same(best, each) or _outdoes(best, each))]
    # Cells of another type may hide the length of a row, so compare such guesses, too.
    others = [each for each in paced if not each.is_folded and each.described.cell != best.described.cell]
    ties += [each for each in nsmallest(MOST_RANKED, others, key=_rank) if not _outdoes(best, each)]
    ties += [each for each in paced if _rivals(best, each)]
    ties = [each for each in ties if not _is_shifted(each, best)]
    if wanting:
        return nothing(wanting, [best, *ties[:1]])
    if ties:
        return nothing(TIED, [best, ties[0]])
    described = _finished(best) if printed else binary.complete(_finished(best), data, arrived.times_s)
    if missing := _unscaled(described, best.values) or _unexplained(described, best, arrived.chunks):
        return nothing(missing, [best])
    return Finding(_as_preset(described), (described,), "", saw)


def _is_printed(data: bytes) -> bool:
    """Whether these bytes are lines of text; the bytes of cells may all be printable, too."""
    return is_text(data) and len(data.splitlines()) > text.LEAST_FRAMES


def _latest(chunks: Sequence[Chunk]) -> list[Chunk]:
    kept: list[Chunk] = []
    size = 0
    for chunk in reversed(chunks):
        size += len(chunk.data)
        if size > MOST_BYTES:
            break
        kept.append(chunk)
    return kept[::-1]


def _rank(guess: Guess) -> tuple[float, int]:
    return -round(guess.fold.score, 4), guess.described.skip + guess.described.tail


def _outdoes(best: Guess, other: Guess) -> bool:
    """Whether a guess is surely better than another; if it leaves out what a hand moves, by far."""
    if other.misfits < best.misfits:
        return best.fold.score > MISFIT_GAIN * other.fold.score
    return best.fold.beats(other.fold) or other.misfits > best.misfits


def _rivals(best: Guess, other: Guess) -> bool:
    """Whether the same cells in the other byte order, a byte earlier or later, are as good and change less.

    The upper bytes of small values are 0, so that both orders read the same but for what is beside the cells.
    """
    is_as_good = other.misfits <= best.misfits or other.fold.score >= best.fold.score
    return _is_swapped(best, other) and is_as_good and other.variation < best.variation


def _is_shifted(guess: Guess, other: Guess) -> bool:
    """Whether the cells surely have the other byte order: in the wrong one, each carry is a jump by 256."""
    return _is_swapped(guess, other) and 0 < SHIFTED * other.carry < guess.carry


def _is_swapped(one: Guess, other: Guess) -> bool:
    """Whether two guesses read 16-bit cells of the same grid in different byte orders."""
    first, second = one.described, other.described
    same = first.cell == second.cell == "u16" and (first.rows, first.columns) == (second.rows, second.columns)
    return same and first.order != second.order


def _confirmed(ranked: Sequence[Guess], data: bytes, times_s: Numbers) -> list[Guess]:
    """Return the nearly equal guesses that a checksum among the skipped bytes confirms; if none, all."""
    near = [guess for guess in ranked if guess.fold.score > NEAR * ranked[0].fold.score]
    summed = [guess for guess in near if binary.complete(_finished(guess), data, times_s).checksum != "none"]
    return summed or list(ranked)


def _misfits(guess: Guess) -> int:
    return guess.misfits


def _is_same(best: Guess, other: Guess) -> bool:
    """Whether two guesses read the same cells."""
    one, two = best.values, other.values
    if best.described == other.described:
        return True
    if best.described.columns != other.described.columns and one.shape == two.shape:
        return False
    return one.shape == two.shape and bool(np.array_equal(one, two))


def _finished(guess: Guess) -> PadFormat:
    """Return a guess's description with its full_scale and invert set."""
    described, values = guess.described, guess.values
    largest, falls = float(values.max()), Movement(values, None).falls
    is_whole = bool((values == np.round(values)).all())
    top = CELL_TOP.get(described.cell) if described.framing == "binary" else None
    scale: float
    if described.framing == "binary" and described.cell in ("u8", "u12"):
        scale = CELL_TOP[described.cell]
    elif is_whole:
        scale = next((each for each in FULL_SCALES if largest <= each), largest)
        scale = min(scale, top) if top else scale
    elif largest <= 0:
        scale = 1.0
    else:
        # Pads rest at full scale if it means no pressure; otherwise a later press may be firmer.
        unit = 10.0 ** math.floor(math.log10(largest))
        rounded = next((each for each in ROUND if largest <= each * unit), 10)
        units = 1e-3 * math.ceil(1e3 * largest / unit) if falls else rounded
        scale = float(f"{units * unit:.6g}")
    return replace(described, full_scale=scale, invert=falls)


def _unscaled(described: PadFormat, values: Numbers) -> str:
    """Say why values are not pressure on the description's scale."""
    if not SMALLEST_SCALE <= described.full_scale <= LARGEST_SCALE:
        return f"its numbers go up to {described.full_scale:g}: print values of a usual size"
    if described.framing == "binary" and described.cell == "u8" and (wrong := binary.unlike_bytes(values)):
        return wrong
    if described.framing == "binary" and described.cell in ("u16", "i16", "u12"):
        bits = values.astype(np.int64)
        changing = int(np.bitwise_or.reduce(bits, axis=None) ^ np.bitwise_and.reduce(bits, axis=None))
        changing //= changing & -changing or 1
        if changing & (changing + 1):
            return "some bits inside its numbers never change: send plain u8, u16, i16 or f32 cells"
    rest = np.median(values, axis=0)
    farthest, top = float(np.abs(values - rest).max()), described.full_scale
    if farthest * MAX_COUNT < LEAST_PRESS * top:
        return (
            f"a press moves its numbers by only {farthest:.4g} of {top:g}: press firmly; if they go no "
            "farther, set full_scale by hand, and print what a press adds where they rest far from 0"
        )
    is_high = np.median(rest[np.ptp(values, axis=0) > 0]) > top / 2
    return "" if is_high == described.invert else PRESSED_LONG


def _unexplained(described: PadFormat, guess: Guess, chunks: Sequence[Chunk]) -> str:
    """Say what the description leaves unexplained when the daemon's own parser reads all that arrived."""
    parser = parser_of(described)
    layout = layout_of(described)
    expected = {
        layout.pressure(np.clip(values, 0, described.full_scale)).tobytes() for values in guess.values
    }
    as_expected = delivered = held = 0
    first_s, last_s = chunks[0].host_s, chunks[-1].host_s
    came_s: list[float] = []
    for chunk in chunks:
        counts = parser.counts
        before = counts.frames + counts.duplicates + counts.bad_time
        delivered_before, held_before = counts.frames, counts.bad_time
        for frame in parser.feed(chunk.data, chunk.host_s):
            as_expected += frame.pressure.tobytes() in expected
        after = counts.frames + counts.duplicates + counts.bad_time
        if chunk.host_s > (first_s + last_s) / 2:
            delivered += counts.frames - delivered_before
            held += counts.bad_time - held_before
        came_s += [chunk.host_s] * (after - before)
    if len(came_s) < text.LEAST_FRAMES:
        return "too few frames come"
    # A number taken for a clock may hold frames back; those that come must be the cells that were found.
    if as_expected < MOSTLY * min(parser.counts.frames, len(guess.values)):
        return "other bytes look like the header of its frames"
    if delivered < EXPLAINED * (delivered + held):
        return "its first number is taken for a clock, but jumps: print it after the cells"
    refused = parser.counts.bad_framing + parser.counts.bad_checksum + parser.counts.bad_value
    share = len(came_s) / (len(came_s) + max(refused - 1, 0))
    if described.framing == "binary":
        sent = sum(len(chunk.data) for chunk in chunks)
        share = min(share, (len(came_s) + 2) * frame_bytes(described) / sent)
    if share < EXPLAINED:
        return f"that explains {100 * share:.0f} % of what came, not {100 * EXPLAINED:.0f} %"
    rate_hz = len(came_s) / max(last_s - first_s, 1e-3)
    if not SLOWEST_HZ <= rate_hz <= FASTEST_HZ:
        return f"{rate_hz:.1f} frames/s; 10 to 500 are needed"
    if max(np.diff([first_s, *came_s])) > LONGEST_PAUSE_S:
        return "at times no frame comes: the pad has to send while nothing presses it, too"
    parts, _ = np.histogram(came_s, PARTS, (first_s, last_s))
    if parts.max() > UNEVEN * np.median(parts) or UNEVEN * parts.min() < np.median(parts):
        return "frames do not come at a steady rate"
    return ""


def _as_preset(described: PadFormat) -> PadFormat:
    """Return the preset with the same line, grid and direction; for text, only if the preset has a crop."""
    for preset in PRESETS.values():
        is_text_without_border = preset.framing == "text" and not preset.crop
        same = (preset.line, preset.rows, preset.columns, preset.invert)
        is_same = same == (described.line, described.rows, described.columns, described.invert)
        if is_same and not is_text_without_border:
            return preset
    return described


def as_yaml(described: PadFormat) -> str:
    """Return a description as it stands in the configuration, on one line."""
    for name, preset in PRESETS.items():
        if preset == described:
            return f"format: {name}"
    always = {"framing": described.framing, "rows": described.rows, "columns": described.columns}
    fields = always | msgspec.to_builtins(described) | {"full_scale": described.full_scale}
    shown = {key: f"{value:g}" if key == "full_scale" else json.dumps(value) for key, value in fields.items()}
    return f"format: {{{', '.join(f'{key}: {value}' for key, value in shown.items())}}}"
