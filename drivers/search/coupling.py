"""How numbers move together: which grid they form, and whether a hand moves them.

A hand presses cells that lie beside each other. So, while it presses, the right grid is the one in which
neighbours move together most, and it is a pad only if they do so far more than the same cells shuffled.
"""

from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from touchd.drivers.pad.format import LONGEST_SIDE, SHORTEST_SIDE

Numbers = NDArray[np.float64]

# Most frames that are compared; more only take time.
MOST_FRAMES = 360
# Stretches of the time in which something moves; one grid has to be better than another in most of them.
STRETCHES = 12
# A better grid wins this many times what it loses, and at least what one pair of cells adds.
MOSTLY_WON = 8.0
PAIRS_WON = 1.0
SHUFFLES = 100
# Standard deviations by which neighbours must exceed shuffled cells, in total and along each side.
# By contact, shuffled cells of a real pad reach 3.7 in total; the pad itself reaches 2 along its weaker side.
SURE_Z, SURE_Z_A_SIDE, CONTACT_Z_A_SIDE = 5.0, 3.2, 2.0
# A movement within this many noises is noise, which also drifts along the wires.
QUIET_NOISES = 4.0
# A number is pressed if it rises by more noises than this. A frame in which far fewer numbers are pressed
# than this share of the most weighs less than the others.
CONTACT_NOISES, FEW_PRESSED = 2.0, 0.05
# If a hand presses for most of the time, the pad is at rest for at least this share of it.
SELDOM_AT_REST = 0.25
# The 30th percentile of a normal distribution's absolute deviations; a pad may be pressed half the time.
NORMAL_30 = 0.385
# A movement within this many noises is the pad's own, not a press.
PRESSED_NOISES = 8.0
# Parts of the time; in at least one of them, nothing presses a given cell.
CALM_PARTS = 16
# A number that a hand moves moves this many times as much, on average, as in calm frames.
FOLLOWS = 2.0
# From one frame to the next, such a number keeps this share of its movement.
LASTS = 0.5
# A number that moves farther than the cells by this factor is a total of them.
MOST_OVER = 2.0
# A number that is this many times as noisy as most is hardly a cell.
WILD_NOISES = 20.0
# There is a seam between two rows if cells across it move together by less than this share of the usual, and
# both rows move by this share of the mean.
SEAM_SHARE, BUSY_SHARE = 0.45, 0.25
# Across a seam, the nearest rows that move are compared, up to this many rows apart.
SEAM_ROWS = 3
# A total, mean or maximum equals that of the other rows in this share of the frames in which they move.
MOSTLY_EQUAL = 0.95
# Numbers that are unlike the cells are fewer than this share of what a hand moves.
FEW_BEYOND = 0.2
# Rows alternate between kinds if rows of one kind differ in movement by less than this share of what rows of
# different kinds differ by, or share this much more with the next row of their kind than with the next row.
ALTERNATES, SHARES_MORE = 0.33, 0.45
MOST_KINDS = 4
# A checksum is the cells' sum modulo a number that is at least this many times a cell's step.
LEAST_MODULUS = 16
# A hand has to reach this share of the cells, and half of the rows and columns.
REACHED = 0.3
# It reaches a row that moves by this share of the farthest, and may miss this many outer rows on a side.
FAINT = 0.05
MOST_MISSED = 1
# Numbers that fall by more than this share of what they rise do both under a hand.
BOTH_WAYS = 0.5
# Frames alternate between kinds if a later frame differs by less than this share of what the next one does.
TURNS_SHARE = 0.8
MOST_TURNS = 64
NOT_TOGETHER = "neighbouring cells do not move together: press one place at a time while I listen"
KINDS = "its rows or columns are of several kinds by turns: print one number for each cell, of one pad"
TOO_LITTLE = (
    "a hand reached too little of the pad: press all over it while I listen, and print nothing but its cells"
)


@dataclass(frozen=True, eq=False)
class Fold:
    """A grid laid over numbers from `start` on. by_stretch: how much its neighbours move together."""

    start: int
    rows: int
    columns: int
    by_stretch: Numbers

    @property
    def score(self) -> float:
        return float(self.by_stretch.mean())

    @property
    def cells(self) -> int:
        return self.rows * self.columns

    def beats(self, other: "Fold") -> bool:
        """Whether this grid explains the movement surely better than another grid of the same frames."""
        gain = self.by_stretch - other.by_stretch
        lost = -float(np.minimum(gain, 0).sum())
        won = float(np.maximum(gain, 0).sum())
        least = len(gain) * abs(self.score) * PAIRS_WON / self.cells
        return won - lost > least and won > MOSTLY_WON * lost


def sides(cells: int) -> list[tuple[int, int]]:
    """Return the grids that this many cells can form, as (rows, columns)."""
    return [
        (rows, cells // rows)
        for rows in range(SHORTEST_SIDE, LONGEST_SIDE + 1)
        if cells % rows == 0 and SHORTEST_SIDE <= cells // rows <= LONGEST_SIDE
    ]


def is_counter(numbers: Numbers) -> NDArray[np.bool_]:
    """Whether each of (frames, numbers) only counts: a clock, a sequence number, or a byte of one."""
    steps = np.diff(numbers, axis=0)
    rises, falls = (steps > 0).mean(axis=0), (steps < 0).mean(axis=0)
    parts = np.array_split(steps, 6)
    everywhere = np.all([(part > 0).any(axis=0) for part in parts if len(part)], axis=0)
    counts: NDArray[np.bool_] = (rises > 0.85) | (everywhere & (falls == 0))
    return counts


class Movement:
    """How (frames, numbers) move about their rest, on a scale that compresses firm presses and omits noise.

    Numbers that only count are left out, and so is what all numbers have in common.
    by_contact: compare which numbers are pressed instead of how far they move. That finds the neighbours on a
    pad whose cells differ widely under one hand, or go the other way where a hand is near.
    """

    def __init__(
        self, numbers: Numbers, counters: NDArray[np.bool_] | None = None, by_contact: bool = False
    ) -> None:
        counts = is_counter(numbers) if counters is None else counters
        chosen = numbers[:: -(-len(numbers) // MOST_FRAMES)]
        rest = np.median(chosen, axis=0)
        off = chosen - rest
        off[:, counts] = 0.0
        self.wild = _is_wild(off)
        off[:, self.wild] = 0.0
        self.noise = _noise_of(off)
        left_out = counts | self.wild
        self.goes_negative = bool(chosen[:, ~left_out].min(initial=0.0) < -CONTACT_NOISES * self.noise)
        if self.goes_negative and _skew(off) < 0:
            # Signed counts do not fall under a hand, so the hand pressed for most of the time.
            off = np.where(left_out, 0.0, chosen - np.quantile(chosen, SELDOM_AT_REST, axis=0))
        self.farthest = np.abs(off).max(axis=0, initial=0.0)
        self.largest = float(self.farthest.max(initial=0.0))
        # The values of a pad whose largest value means no pressure fall when it is pressed.
        self.falls = bool(_skew(off) < 0)
        moved = _beyond_noise(off, self.noise)
        # Numbers that a hand moves.
        self.pressed = (moved != 0).any(axis=0)
        if by_contact:
            moved = _contacts(-off if self.falls else off, self.noise)
        else:
            moved -= moved.mean(axis=1, keepdims=True)
            moved[:, counts] = 0.0
        self.moved: NDArray[np.float32] = moved.astype(np.float32)
        self.counters = counts
        self.alive = (off != 0).any(axis=0)
        # Numbers that are hardly cells.
        self.odd = self.wild | _is_odd(chosen, rest, self.pressed, ~self.alive & ~counts)
        resembling = _resembles(rest, off, self.pressed) & ~left_out if by_contact else np.False_
        energy = np.square(moved).sum(axis=1)
        busy = np.flatnonzero(energy > 0.25 * energy.mean())
        self.follows = self.pressed & ~_is_switch(chosen) & _follows(off, moved, energy)
        self._like_cells = self.follows | resembling
        self._all_like_cells = int(self._like_cells.sum())
        # If too little moves, no stretches are made, and every grid scores 0.
        self._stretches = np.array_split(busy, STRETCHES) if len(busy) >= STRETCHES else []
        total = np.square(self.moved).sum(axis=1)
        self._total = np.array([total[part].sum() for part in self._stretches])
        self._whole_total = max(float(total.sum()), 1e-9)
        # What two numbers share by chance; 0 once their mean is subtracted.
        self._chance = np.zeros(len(self._stretches))
        if by_contact:
            others = max(np.count_nonzero(~counts), 2) * max(np.count_nonzero(~counts) - 1, 1)
            chance = (np.square(self.moved.sum(axis=1)) - total) / others
            self._chance = np.array([chance[part].sum() for part in self._stretches])
        self._sums: dict[int, Numbers] = {}
        self._steps: dict[int, Numbers] = {}

    @property
    def is_pressed(self) -> bool:
        """Whether anything moved by more than noise."""
        return self.largest > PRESSED_NOISES * self.noise and len(self._stretches) > 0

    def fold(self, start: int, rows: int, columns: int) -> Fold:
        """Return how much neighbours move together, at most 1, in a grid from number `start` on."""
        if not self._stretches:
            return Fold(start, rows, columns, np.zeros(STRETCHES))
        stop = start + rows * columns
        beside, wraps = self._between(1), self._products(1)
        along = beside[:, stop - 1] - beside[:, start]
        along = along - wraps[:, start + columns - 1 : stop - 1 : columns].sum(axis=1)
        below = self._between(columns)
        across = below[:, stop - columns] - below[:, start]
        pairs = rows * (columns - 1) + columns * (rows - 1)
        together = along + across - pairs * self._chance
        fitting = 1 - self.odd_in(start, rows, columns) / (rows * columns)
        return Fold(start, rows, columns, fitting * together / np.maximum(2 * self._total, 1e-9))

    def misfits(self, start: int, rows: int, columns: int) -> int:
        """Return how many numbers outside these cells look like cells, and how many inside do not."""
        stop = start + rows * columns
        outside = self._all_like_cells - int(self._like_cells[start:stop].sum())
        return outside + self.odd_in(start, rows, columns)

    def odd_in(self, start: int, rows: int, columns: int) -> int:
        """Return how many cells of a grid are hardly cells, not counting a border that never changes."""
        if not self.odd.any():
            return 0
        stop = start + rows * columns
        odd = self.odd[start:stop].reshape(rows, columns)
        inner = self.alive[start:stop].reshape(rows, columns)[1:-1, 1:-1]
        has_border = self.alive[start:stop].sum() == inner.sum()
        return int((odd[1:-1, 1:-1] if has_border else odd).sum())

    def is_cut(self, start: int, cells: int) -> bool:
        """Whether a hand moves a number beside these cells, too, other than their total."""
        beside = (at for at in (start - 1, start + cells) if 0 <= at < len(self.follows))
        most = MOST_OVER * self.farthest[start : start + cells].max()
        return any(self.follows[at] and self.farthest[at] <= most for at in beside)

    def is_stride(self, columns: int) -> bool:
        """Whether numbers at this distance move together more than a little nearer or farther, and more than
        at any nearer distance of which that is true."""
        if columns + 1 >= len(self.lags):
            return False
        nearer, here, farther = self.lags[1:columns], self.lags[2 : columns + 1], self.lags[3 : columns + 2]
        is_peak = (here >= nearer) & (here >= farther)
        return bool(is_peak[-1] and here[-1] >= here[is_peak].max())

    @cached_property
    def lags(self) -> Numbers:
        """How much numbers at each distance move together, at most 1."""
        width = self.moved.shape[1]
        shared = np.zeros(width)
        for part in self._stretches:
            power = np.square(np.abs(np.fft.rfft(self.moved[part], 2 * width))).sum(axis=0)
            shared += np.fft.irfft(power)[:width]
        return shared / self._whole_total

    def _products(self, distance: int) -> Numbers:
        """Return the product of each number and the one at a distance, (stretches, numbers)."""
        if distance not in self._steps:
            both = self.moved[:, : max(self.moved.shape[1] - distance, 0)] * self.moved[:, distance:]
            found = np.array([both[part].sum(axis=0, dtype=np.float64) for part in self._stretches])
            self._steps[distance] = np.pad(found, ((0, 0), (0, distance)))
        return self._steps[distance]

    def _between(self, distance: int) -> Numbers:
        if distance not in self._sums:
            self._sums[distance] = np.pad(np.cumsum(self._products(distance), axis=1), ((0, 0), (1, 0)))
        return self._sums[distance]


def objection(numbers: Numbers, rows: int, columns: int, by_contact: bool = False) -> str:
    """Say why (frames, cells) are not a pressed pad of this grid; "" if they are proven to be one."""
    movement = Movement(numbers, np.zeros(numbers.shape[1], np.bool_), by_contact)
    if not movement.is_pressed:
        return (
            f"nothing presses the pad (its numbers move by {movement.largest:.4g}): press it while I listen"
        )
    is_below_0 = (numbers[:, movement.pressed].max(axis=0) <= 0).mean() > 0.5
    if movement.goes_negative and (movement.falls or is_below_0):
        return "a press makes its numbers negative, and those are cut at 0: print what a press adds"
    if 0 < _has_fraction(numbers).mean() < FEW_BEYOND:
        return "some numbers among its cells have a fraction, the others have none: print the cells alone"
    reached = movement.pressed.reshape(rows, columns)
    if reached.mean() < REACHED or min(reached.any(axis=0).mean(), reached.any(axis=1).mean()) < 0.5:
        return TOO_LITTLE
    clearly = reached & (movement.farthest >= FAINT * movement.largest).reshape(rows, columns)
    if max(_missed(clearly.any(axis=1)), _missed(clearly.any(axis=0))) > MOST_MISSED:
        return TOO_LITTLE
    alive = movement.alive.reshape(rows, columns)
    edges = [alive[0].any(), alive[-1].any(), alive[:, 0].any(), alive[:, -1].any()]
    if any(edges) and not all(edges):
        return TOO_LITTLE
    moved = movement.moved
    cells = np.arange(rows * columns).reshape(rows, columns)
    together = moved.T @ moved
    beside = (cells[:, :-1].ravel(), cells[:, 1:].ravel())
    below = (cells[:-1].ravel(), cells[1:].ravel())
    rng = np.random.default_rng(0)
    shuffled = [rng.permutation(cells.size) for _ in range(SHUFFLES)]

    def deviations(one: NDArray[np.int_], other: NDArray[np.int_]) -> float:
        by_chance = np.array([together[order[one], order[other]].sum() for order in shuffled])
        return float((together[one, other].sum() - by_chance.mean()) / max(by_chance.std(), 1e-9))

    both = np.concatenate([beside[0], below[0]]), np.concatenate([beside[1], below[1]])
    sure_a_side = CONTACT_Z_A_SIDE if by_contact else SURE_Z_A_SIDE
    if by_contact and abs(rows - columns) > min(abs(one - other) for one, other in sides(cells.size)):
        return NOT_TOGETHER
    if deviations(*both) < SURE_Z or min(deviations(*beside), deviations(*below)) < sure_a_side:
        return NOT_TOGETHER
    if _runs_to_and_fro(together, rows, columns):
        return "every other row seems to run backwards: print all rows in one direction"
    ways = [(lines, *_shared(together, lines)) for lines in (cells, cells.T)]
    if any(_has_seam(together, *each) for each in ways):
        return "its parts move apart: two pads in one frame? press across the middle, too"
    if any(_alternates(share, own) for _, share, own in ways):
        return KINDS
    grid = numbers.reshape(-1, rows, columns)
    if _has_total(grid, movement.noise) or _has_total(grid.swapaxes(1, 2), movement.noise):
        return (
            "an outer row or column is a total, a checksum or a maximum of the others: print the cells alone"
        )
    above, below = (np.maximum(sign * numbers - CONTACT_NOISES * movement.noise, 0).sum() for sign in (1, -1))
    if below > BOTH_WAYS * above:
        return "a hand moves its numbers up and down: print pressure, not how it changes"
    if _takes_turns(numbers):
        return "frames of several kinds come by turns: two pads on one line, or a part of a frame each"
    return ""


def _is_wild(off: Numbers) -> NDArray[np.bool_]:
    """Whether each number jumps from frame to frame far more than most, as a clock's low byte does."""
    of_each = np.median(np.abs(np.diff(off, axis=0)), axis=0)
    alive = of_each[of_each > 0]
    usual = np.median(alive) if 4 * len(alive) > off.shape[1] else np.inf
    wild: NDArray[np.bool_] = of_each > WILD_NOISES * usual
    return wild


def _resembles(rest: Numbers, off: Numbers, pressed: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Whether each number changes and has a rest and a spread like pressed ones, as a cell at an edge."""
    if not pressed.any():
        return pressed
    spread = off.std(axis=0)
    is_near = (rest >= rest[pressed].min()) & (rest <= rest[pressed].max())
    alike: NDArray[np.bool_] = is_near & (spread > 0) & (spread <= spread[pressed].max())
    return alike


def _is_odd(
    numbers: Numbers, rest: Numbers, pressed: NDArray[np.bool_], still: NDArray[np.bool_]
) -> NDArray[np.bool_]:
    """Whether each number is unlike the pressed ones: it never changes, while they change even at rest or
    rest at other values; or it always lies beyond their range; or it alone has a fraction."""
    if not pressed.any():
        return pressed
    cells, rests = numbers[:, pressed], rest[pressed]
    parts = np.array_split(np.diff(cells, axis=0) != 0, CALM_PARTS)
    at_calmest = np.min([part.mean(axis=0) for part in parts if len(part)], axis=0)
    is_no_rest = (rest < rests.min()) | (rest > rests.max()) | bool(np.median(at_calmest) > 0)
    is_beyond = numbers.min(axis=0) > np.median(cells.max(axis=0))
    is_beyond |= numbers.max(axis=0) < np.median(cells.min(axis=0))
    # Cells that rest at different values lie beyond one another, too.
    is_beyond &= is_beyond[pressed].mean() < FEW_BEYOND
    # If the cells are whole numbers, a number with a fraction is not a cell.
    has_fraction = _has_fraction(numbers)
    is_other = has_fraction & (has_fraction[pressed].mean() < FEW_BEYOND)
    odd: NDArray[np.bool_] = (still & is_no_rest) | is_beyond | is_other
    return odd


def _has_fraction(numbers: Numbers) -> NDArray[np.bool_]:
    fractions: NDArray[np.bool_] = (numbers % 1 != 0).any(axis=0)
    return fractions


def _is_switch(numbers: Numbers) -> NDArray[np.bool_]:
    """Whether each number has two values at most, as a status has."""
    at_end = (numbers == numbers.min(axis=0)) | (numbers == numbers.max(axis=0))
    switch: NDArray[np.bool_] = at_end.all(axis=0)
    return switch


def _follows(off: Numbers, moved: Numbers, energy: Numbers) -> NDArray[np.bool_]:
    """Whether each number moves more while others do, unlike a status, and smoothly, unlike a checksum."""
    busy = energy >= 0.25 * energy.mean()
    about = off[busy] - off[busy].mean(axis=0)
    lasts = (about[1:] * about[:-1]).sum(axis=0) > LASTS * np.square(about).sum(axis=0)
    size = np.abs(moved)
    idle = size[~busy].mean(axis=0) if (~busy).any() else 0.0
    follows: NDArray[np.bool_] = lasts & (size.mean(axis=0) > FOLLOWS * idle)
    return follows


def _beyond_noise(off: Numbers, noise: float) -> Numbers:
    """Return movements beyond noise, firm ones compressed."""
    beyond = np.maximum(np.abs(off) - QUIET_NOISES * noise, 0)
    moved: Numbers = np.arcsinh(beyond / (QUIET_NOISES * noise)) * np.sign(off)
    return moved


def _contacts(off: Numbers, noise: float) -> Numbers:
    """Return which numbers are pressed; frames weigh the same, but those with hardly any press less."""
    pressed = off > CONTACT_NOISES * noise
    pressed_at_once = pressed.sum(axis=1, keepdims=True)
    contacts: Numbers = pressed / np.sqrt(pressed_at_once + max(FEW_PRESSED * pressed_at_once.max(), 1e-9))
    return contacts


def _noise_of(off: Numbers) -> float:
    """Return how far a number strays at rest: from frame to frame, or slowly."""
    steps = np.abs(np.diff(off, axis=0))
    of_each = np.maximum(np.median(steps, axis=0), np.quantile(np.abs(off), 0.3, axis=0) / NORMAL_30)
    alive = of_each[of_each > 0]
    usual = float(np.median(alive)) if 4 * len(alive) > off.shape[1] else 0.0
    positive = steps[steps > 0]
    smallest = float(positive.min()) if positive.size else 1.0
    return max(usual, smallest, 1e-4 * float(np.abs(off).max(initial=0.0)))


def _skew(off: Numbers) -> float:
    scaled = off / max(float(np.abs(off).max(initial=0.0)), 1e-9)
    return float((scaled * scaled * scaled).sum())


def _runs_to_and_fro(together: NDArray[np.float32], rows: int, columns: int) -> bool:
    """Whether neighbours move together more if every other row, or every other half of one, is reversed."""

    def total(cells: NDArray[np.int_]) -> float:
        beside, below = together[cells[:, :-1], cells[:, 1:]], together[cells[:-1], cells[1:]]
        return float(beside.sum() + below.sum())

    plain = np.arange(rows * columns).reshape(rows, columns)
    for length in {columns, columns // 2} if columns % 2 == 0 else {columns}:
        folded = plain.reshape(-1, length).copy()
        folded[1::2] = folded[1::2, ::-1]
        if total(folded) > total(plain):
            return True
    return False


def _missed(reached: NDArray[np.bool_]) -> int:
    """Return how many consecutive rows a hand missed, from the first or the last one on."""
    return int(max(reached.argmax(), reached[::-1].argmax()))


def _shared(together: NDArray[np.float32], cells: NDArray[np.int_]) -> tuple[Numbers, Numbers]:
    """Return the share of movement that two rows have in common, (rows, rows), and each row's movement."""
    shared = np.array([[together[one, other].sum() for other in cells] for one in cells], np.float64)
    own = np.diagonal(shared)
    return shared / np.sqrt(np.maximum(np.outer(own, own), 1e-9)), own


def _has_seam(together: NDArray[np.float32], cells: NDArray[np.int_], share: Numbers, own: Numbers) -> bool:
    """Whether one half repeats the other, or rows move apart where equal parts meet.

    Parts too short for a pad are not compared. share, own: see `_shared`.
    """
    if len(cells) < 2 * SHORTEST_SIDE:
        return False
    is_busy = own > BUSY_SHARE * own.mean()
    pairs = is_busy[:, None] & is_busy
    if np.diagonal(pairs, 1).sum() < 3:
        return False
    middle = len(cells) // 2
    if len(cells) % 2 == 0 and pairs[middle - 1, middle]:
        top, bottom = cells[:middle].ravel(), cells[middle:].ravel()
        repeated = together[top, bottom].sum() / np.sqrt(own[:middle].sum() * own[middle:].sum())
        beside = sum(together[one, other].sum() for one, other in pairwise(cells))
        if repeated > beside / own.sum():
            return True
    usual = [np.median(np.diagonal(share, far)[np.diagonal(pairs, far)]) for far in range(1, SEAM_ROWS + 1)]
    for parts in range(2, len(cells) // SHORTEST_SIDE + 1):
        if len(cells) % parts:
            continue
        # Halves of one pad are often pressed one at a time: compare only rows that touch.
        farthest = 1 if parts == 2 else SEAM_ROWS
        seams = []
        for cut in range(len(cells) // parts, len(cells), len(cells) // parts):
            for far, expected in enumerate(usual[:farthest], 1):
                above = np.arange(cut - far, cut)
                across = above[pairs[above, above + far]]
                if len(across):
                    seams.append(share[across, across + far].mean() < SEAM_SHARE * expected)
                    break
        if seams and all(seams):
            return True
    return False


def _alternates(share: Numbers, own: Numbers) -> bool:
    """Whether rows are of several kinds by turns, as a reading and its baseline, or the rows of two pads."""
    is_busy = own > BUSY_SHARE * own.mean()
    beside = np.diagonal(share, 1)
    for kinds in range(2, MOST_KINDS + 1):
        if len(own) % kinds or len(own) < kinds * SHORTEST_SIDE:
            continue
        if not is_busy.reshape(-1, kinds).any(axis=0).all():
            return True
        meets = np.arange(kinds - 1, len(beside), kinds)
        within, across = np.delete(beside, meets), beside[meets]
        is_less = (across < np.minimum(beside[meets - 1], beside[meets + 1])).all()
        if is_less and 1 - within.mean() < ALTERNATES * (1 - across.mean()):
            return True
        if np.diagonal(share, kinds).mean() > beside.mean() + SHARES_MORE:
            return True
    return False


def _has_total(grid: Numbers, noise: float) -> bool:
    """Whether one of the two outer rows of (frames, rows, columns) is made of the others: their sum, mean or
    maximum, or a checksum."""
    for turned in (grid, grid[:, ::-1]):
        for outer in (1, 2):
            total, others = turned[:, -outer], turned[:, :-outer]
            mean, highest = others.mean(axis=1), others.max(axis=1)
            moves = mean - others.min(axis=1) > PRESSED_NOISES * noise
            moves &= np.ptp(total, axis=0) > PRESSED_NOISES * noise
            # Row totals may come after column totals; means and maxima hardly come in pairs.
            for made in (others.sum(axis=1), mean, highest)[: 3 if outer == 1 else 1]:
                if moves.any() and (np.abs(total - made)[moves] <= noise).mean() > MOSTLY_EQUAL:
                    return True
            if not (turned % 1).any() and _is_checksum(total, others):
                return True
    return False


def _is_checksum(total: Numbers, others: Numbers) -> bool:
    """Whether a row of whole numbers is the sum of the others modulo some number, or their XOR."""
    unit = _usual_step(others)
    for off in (others.sum(axis=1) - total, others.sum(axis=1) + total):
        modulus = _usual_step(off)
        steps = np.diff(off, axis=0)
        if modulus >= LEAST_MODULUS * unit and (steps[steps != 0] % modulus == 0).mean() > MOSTLY_EQUAL:
            return True
    both = np.bitwise_xor.reduce(others.astype(np.int64), axis=1)
    moves = np.diff(both, axis=0, prepend=both[:1]) != 0
    made = (both, (both ^ both >> 8) & 0xFF)
    return any(moves.any() and (total == each)[moves].mean() > MOSTLY_EQUAL for each in made)


def _usual_step(numbers: Numbers) -> float:
    """Return the most frequent change between two frames of whole numbers; 0 if they never change."""
    steps = np.abs(np.diff(numbers, axis=0))
    sizes, times = np.unique(steps[steps > 0], return_counts=True)
    return float(sizes[times.argmax()]) if len(sizes) else 0.0


def _takes_turns(numbers: Numbers) -> bool:
    """Whether some later frame resembles a frame more than the next one does."""
    off = numbers - np.median(numbers, axis=0)
    moved = _beyond_noise(off, _noise_of(off))
    energy = np.square(moved).sum(axis=1)
    most = min(MOST_TURNS, len(moved) // 3)
    change = [
        float(
            np.square(moved[step:] - moved[:-step]).sum() / max((energy[step:] + energy[:-step]).sum(), 1e-9)
        )
        for step in range(1, most)
    ]
    return bool(change and min(change[1:], default=1.0) < TURNS_SHARE * change[0])
