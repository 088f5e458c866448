"""Guesses the grids that the numbers of a text may form."""

import math
import re
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from operator import lt

import numpy as np
from numpy.typing import NDArray

from touchd.drivers.pad.format import LONGEST_SIDE, PadFormat
from touchd.drivers.pad.text import ended_at, lines_in, numbers_in
from touchd.drivers.search.coupling import Fold, Movement, Numbers, is_counter, sides

LEAST_FRAMES = 8
LEAST_NUMBERS = 16
Flags = NDArray[np.bool_]
# Most numbers before and after a line's cells; by contact, more cannot be distinguished from cells.
MOST_SKIP, MOST_TAIL = 8, 8
CONTACT_SKIP, CONTACT_TAIL = 4, 2
MOSTLY = 0.9
MOST_ENDS = 3
# A number and the letters that follow it directly, such as a unit; 0x begins a number in hex.
LETTERS = re.compile(
    rb"(?<![\w.]) (?!0[xX]) [-+]? (?: \d+\.?\d* | \.\d+ ) (?: [eE][-+]?\d+ )? (\w*)", re.VERBOSE
)
DIGIT_LETTER = re.compile(rb"\d[A-Za-z_]")
# A line of other output, rather than of cells.
WORD = re.compile(rb"[A-Za-z:=]")
# If the lines around a separator are this many times as similar as other neighbours, each line is a frame.
SAME_LINE = 0.8
# Least numbers of a line whose letters change.
LEAST_CHANGING = 4
# Numbers with a comma each, and something else between them.
COMMAS = re.compile(rb"[-+]?\d+,\d+%?(?:[;\t ]+[-+]?\d+,\d+%?){3,}[;\t ]*")
# Two numbers with dashes or dots in place of a number between them.
LEFT_OUT = re.compile(rb"\d[ \t,;|]+(?:-{2,}|\.{2,})[ \t,;|]+\d")
NO_DIGITS = bytes(set(range(256)) - set(b"0123456789"))


@dataclass(frozen=True)
class Line:
    """A line's numbers, the number of its label, and its text."""

    numbers: Sequence[float]
    label: int | None
    text: bytes


@dataclass(frozen=True, eq=False)
class Guess:
    """A description that may be right, what it reads, and how well its neighbours move together.

    misfits: how many numbers a hand moves outside the cells, and how many cells are unlike the others.
    is_cut: such a number stands beside the cells. is_short: a whole row or column beside the cells may be
    cells, too. is_folded: at the distance of its rows, numbers move together more than a little nearer or
    farther.
    """

    described: PadFormat
    values: Numbers
    fold: Fold
    misfits: int
    is_cut: bool
    is_folded: bool = True
    is_short: bool = False

    @cached_property
    def variation(self) -> float:
        """How much the values change from frame to frame, in the mean over all cells."""
        return float(np.abs(np.diff(self.values, axis=0)).mean())

    @cached_property
    def carry(self) -> float:
        """How much whole values change, on average, when their upper byte goes one step; 0 if none does."""
        steps = np.abs(np.diff(self.values, axis=0))
        is_step = np.abs(np.diff(self.values // 256, axis=0)) == 1
        return float(steps[is_step].mean()) if is_step.any() else 0.0


def lines_of(data: bytes) -> list[Line]:
    """Return the whole lines of a text."""
    text = data[: ended_at(data)]
    return [Line(*numbers_in(line), line) for line in lines_in(text)][1:] if text else []


def unreadable(lines: Sequence[Line]) -> str:
    """Say why the numbers of these lines are not what they seem to be; "" if they may be."""
    if sum(LEFT_OUT.search(line.text) is not None for line in lines) >= LEAST_FRAMES:
        return "some cells are dashes or dots: print a number for each cell"
    with_commas = sum(COMMAS.fullmatch(line.text.strip()) is not None for line in lines)
    if with_commas >= max(LEAST_FRAMES, len(lines) / 2):
        return "its numbers have commas for points: print points"
    widths = Counter(len(line.numbers) for line in lines if len(line.numbers) >= LEAST_CHANGING)
    width, most = widths.most_common(1)[0] if widths else (0, 0)
    is_frame = most > len(lines) / 2
    read = [line.text for line in lines if not is_frame or len(line.numbers) == width]
    if not any(DIGIT_LETTER.search(line) for line in read):
        return ""
    changing: list[Counter[bytes]] = []
    for line in read:
        for number, letters in enumerate(LETTERS.findall(line)):
            changing += [Counter() for _ in range(number + 1 - len(changing))]
            changing[number][letters] += 1
    often = (letters.total() - letters.most_common(1)[0][1] >= LEAST_FRAMES for letters in changing)
    if sum(often) >= LEAST_CHANGING:
        return (
            "the letters behind its numbers change, as in hexadecimal or with several units: print plain "
            "decimal numbers, or 0x before each"
        )
    return ""


def guesses(lines: Sequence[Line], by_contact: bool = False) -> Iterator[Guess]:
    """Yield the grids that the numbers of a text may form."""
    weight: Counter[int] = Counter()
    for line in lines:
        weight[len(line.numbers)] += len(line.numbers)
    total = sum(weight.values())
    for width, numbers in weight.most_common(2):
        if width == 0 or numbers < total / 2:
            continue
        if width >= LEAST_NUMBERS:
            yield from _in_one_line(
                [line.numbers for line in lines if len(line.numbers) == width], by_contact
            )
        if width <= LONGEST_SIDE + MOST_SKIP + MOST_TAIL:
            yield from _in_several_lines(lines, width, by_contact)


def _in_one_line(frames: Sequence[Sequence[float]], by_contact: bool) -> Iterator[Guess]:
    numbers = np.array(frames)
    if len(numbers) < LEAST_FRAMES or not np.isfinite(numbers).all():
        return
    movement = Movement(numbers, by_contact=by_contact)
    width = numbers.shape[1]
    most_skip, most_tail = (CONTACT_SKIP, CONTACT_TAIL) if by_contact else (MOST_SKIP, MOST_TAIL)
    last_counter = int(np.flatnonzero(movement.counters[:most_skip]).max(initial=-1))
    for skip in range(last_counter + 1, most_skip + 1):
        for tail in range(most_tail + 1):
            if movement.counters[skip : width - tail].any():
                continue
            for rows, columns in sides(width - skip - tail):
                described = PadFormat(framing="text", rows=rows, columns=columns, skip=skip, tail=tail)
                values = numbers[:, skip : width - tail]
                misfits = movement.misfits(skip, rows, columns)
                is_cut = movement.is_cut(skip, rows * columns)
                is_folded = by_contact or movement.is_stride(columns)
                fold = movement.fold(skip, rows, columns)
                beside = numbers[:, max(skip - columns, 0) : skip], numbers[:, width - tail :][:, :columns]
                is_short = any(each.shape[1] == columns and _may_be_cells(each, values) for each in beside)
                # A number that is wrongly among the cells shifts one of them out.
                next_to = numbers[:, max(skip - 1, 0) : skip], numbers[:, width - tail :][:, :1]
                is_shifted = movement.odd_in(skip, rows, columns) > 0
                is_short |= is_shifted and any(each.size and _may_be_cells(each, values) for each in next_to)
                yield Guess(described, values, fold, misfits, is_cut, is_folded, is_short)


def _in_several_lines(lines: Sequence[Line], width: int, by_contact: bool) -> Iterator[Guess]:
    found = _frames_of(lines, width)
    if found is None:
        return
    frames, least_skip, end = found
    numbers = np.array(frames)
    if not np.isfinite(numbers).all():
        return
    laid = numbers.reshape(len(numbers), -1)
    whole = Movement(laid)
    flat = whole.moved.reshape(len(whole.moved), *numbers.shape[1:])
    off = np.where(whole.counters, 0.0, laid - np.median(laid, axis=0))
    if width >= LEAST_NUMBERS and _are_frames(off.reshape(numbers.shape)):
        return
    is_wrapped = _goes_on(lines, numbers)
    total = float(np.square(flat).sum())
    still = ~whole.alive.reshape(numbers.shape[1:])
    pressed = whole.follows.reshape(numbers.shape[1:])
    counts = whole.counters.reshape(numbers.shape[1:])
    for skip in range(least_skip, MOST_SKIP + 1):
        for tail in range(MOST_TAIL + 1):
            stop = width - tail
            columns = stop - skip
            if columns < 1 or counts[:, skip:stop].any() or _leads(numbers, still, skip, stop):
                continue
            cells = numbers[:, :, skip:stop].reshape(len(numbers), -1)
            movement = Movement(cells, np.zeros(cells.shape[1], np.bool_), by_contact)
            # Leaving cells out must not make a grid look better.
            share = float(np.square(flat[:, :, skip:stop]).sum()) / max(total, 1e-9)
            grids = sides(cells.shape[1])
            # Several lines may make a row, or a line several rows, if that is surely a better grid.
            natural = (numbers.shape[1], columns)
            usual = movement.fold(0, *natural) if natural in grids else None
            for rows, each in grids:
                fold = movement.fold(0, rows, each)
                is_whole = max(each, columns) % min(each, columns) == 0
                if usual and (rows, each) != natural and not (is_whole and fold.beats(usual)):
                    continue
                described = PadFormat(
                    framing="text", rows=rows, columns=each, skip=skip, tail=tail, end=end.decode("latin-1")
                )
                fold = Fold(skip, rows, each, fold.by_stretch * share)
                left_out = pressed[:, :skip].sum() + pressed[:, stop:].sum()
                is_short = _are_alike(numbers[:, :, :skip], cells) or _are_alike(numbers[:, :, stop:], cells)
                yield Guess(
                    described, cells, fold, int(left_out), bool(left_out), is_short=is_short or is_wrapped
                )


def _are_frames(off: Numbers) -> bool:
    """Whether each line of (frames, lines, numbers) is a frame: a separator does not make the lines around
    it differ more than other neighbours. off: how far the numbers are from their rest."""
    within = _cosine(off[:, :-1], off[:, 1:])
    return _cosine(off[:-1, -1], off[1:, 0]) > SAME_LINE * within > 0


def _cosine(one: Numbers, other: Numbers) -> float:
    """Return the cosine similarity of two arrays of one shape."""
    shared = float((one * other).sum())
    return shared / max(math.sqrt(np.square(one).sum() * np.square(other).sum()), 1e-9)


def _goes_on(lines: Sequence[Line], cells: Numbers) -> bool:
    """Whether the line after a frame's last full line may hold the rest of its cells.

    It may if it holds numbers alone, and they read like pressed cells or like cells at rest.
    """
    width = cells.shape[2]
    rests = [
        line.numbers
        for before, line in pairwise(lines)
        if len(before.numbers) == width != len(line.numbers) and not WORD.search(line.text)
    ]
    length, times = Counter(map(len, rests)).most_common(1)[0] if rests else (0, 0)
    if not length or times < MOSTLY * len(cells):
        return False
    rest = np.array([each for each in rests if len(each) == length])
    changes = bool(np.ptp(rest, axis=0).any())
    return not is_counter(rest).any() and _may_be_cells(rest, cells if changes else np.median(cells, axis=0))


def _are_alike(beside: Numbers, cells: Numbers) -> bool:
    """Whether the numbers beside the cells may be columns of cells: they are the same in every line."""
    return bool(beside.size and (np.ptp(beside, axis=1) == 0).all() and _may_be_cells(beside, cells))


def _may_be_cells(beside: Numbers, cells: Numbers) -> bool:
    """Whether numbers beside the cells may be cells that nothing has pressed, or dead ones, which read 0."""
    is_within = min(cells.min(), 0) <= beside.min() and beside.max() <= cells.max()
    are_alike = (beside % 1 == 0).all() or (cells % 1 != 0).any()
    return bool(is_within and are_alike)


def _leads(numbers: Numbers, still: Flags, skip: int, stop: int) -> bool:
    """Whether the first or last column is not a cell: it never changes, but differs between lines, or nearly
    all others change."""
    first = numbers[0]
    never_changes = still[:, skip:stop].all(axis=0)
    others = ~still[:, skip:stop][:, ~never_changes]
    others_live = bool(others.size and others.mean() > MOSTLY)
    for column in {skip, stop - 1}:
        is_still = bool(still[:, column].all())
        if is_still and (len(set(first[:, column])) > 1 or others_live) and len(first) > 1:
            return True
    return False


def _frames_of(lines: Sequence[Line], width: int) -> tuple[list[list[Sequence[float]]], int, bytes] | None:
    """Return the frames of lines with `width` numbers, how many numbers to skip at least, and the `end`."""
    ends = Counter(line.text.strip() for line in lines if len(line.numbers) != width and line.text.strip())
    suffixes = Counter(_after_numbers(line.text) for line in lines if len(line.numbers) == width)
    marks = [text for text, _ in (ends.most_common(MOST_ENDS) + suffixes.most_common(MOST_ENDS + 1)) if text]
    for skip, end in [*((skip, b"") for skip in range(MOST_SKIP)), *((0, mark) for mark in marks)]:
        if not end.isascii() or not end.decode("ascii", "replace").isprintable():
            continue
        runs = list(_runs(lines, width, skip, end))
        if len(runs) < LEAST_FRAMES:
            continue
        length, times = Counter(map(len, runs[1:-1])).most_common(1)[0]
        inner = runs[1:-1]
        if length > 1 and times * length >= MOSTLY * sum(map(len, inner)):
            return [run for run in inner if len(run) == length], skip, end
    return None


def _runs(lines: Sequence[Line], width: int, skip: int, end: bytes) -> Iterator[list[Sequence[float]]]:
    """Yield the lines between two separators, as the parser of such a format takes them."""
    run: list[Sequence[float]] = []
    leads: Sequence[float] = ()
    for line in lines:
        fits = len(line.numbers) == width
        if end:
            run += [line.numbers] if fits else []
            if line.text.rstrip().endswith(end):
                yield run
                run = []
            continue
        now = line.numbers[:skip] if line.label is None else [line.label, *line.numbers[:skip]]
        if run and (not fits or any(map(lt, now, leads))):
            yield run
            run = []
        if fits:
            run.append(line.numbers)
            leads = now
    if run:
        yield run


def _after_numbers(text: bytes) -> bytes:
    """Return what follows a line's last number."""
    return text[len(text.rstrip(NO_DIGITS)) :].strip()
