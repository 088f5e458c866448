"""Asks the person at the terminal for the pad's grid and for presses, and shows the pad's picture."""

import argparse
import math
import re
import select
import sys
import time
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor

import numpy as np
from msgspec.structs import replace
from numpy.typing import NDArray
from rich.console import Console, Group
from rich.live import Live

from touchd.daemon.view.elements import pad_picture
from touchd.drivers.frame import COLUMNS, ROWS
from touchd.drivers.pad.format import LONGEST_SIDE, SHORTEST_SIDE, PadFormat
from touchd.drivers.pad.parser import FrameParser
from touchd.drivers.pad.port import Port, discard_input, read_waiting
from touchd.drivers.search.listen import Chunk, listen
from touchd.drivers.search.search import Finding, Grid, placements, search, survey

# The slowest pad sends 16 frames in this time; 8 show their size.
REST_S = 2.0
PRESS_S = 40.0
LISTEN_S = 8.0
# Extra time for a hand that has not yet pressed enough of the pad to prove the grid.
LONGER_S = 20.0
SEARCH_EVERY_S = 3.0
CORNER_S = 20.0
PRESSED_COUNTS = 40
# A hand that holds a corner stays within a taxel for this long; one that is still moving does not.
HELD_S = 1.0
HELD_TAXELS = 1.0
PICTURE_SCALE = 2
SHOW_EVERY_S = 0.08

# By the corner at which a press on the top left appears, (is below, is to the right): the two ways to bring
# it to the top left, as (turn, mirror): a turn alone, and a turn with a mirror.
TURNS = {
    (False, False): ((0, False), (90, True)),
    (False, True): ((270, False), (0, True)),
    (True, True): ((180, False), (270, True)),
    (True, False): ((90, False), (180, True)),
}


def can_ask() -> bool:
    """Whether there is a user at a terminal to ask."""
    return sys.stdin.isatty()


def grid_of(text: str) -> Grid:
    """Return rows and columns typed as in 16x16; raises ArgumentTypeError."""
    sides = re.fullmatch(r"\s*(\d{1,3})\s*[x*, ]\s*(\d{1,3})\s*", text, re.IGNORECASE)
    grid = (int(sides[1]), int(sides[2])) if sides else (0, 0)
    if not all(SHORTEST_SIDE <= side <= LONGEST_SIDE for side in grid):
        raise argparse.ArgumentTypeError(
            f"{text.strip()!r} is not ROWSxCOLUMNS of {SHORTEST_SIDE} to {LONGEST_SIDE} each, as in 16x16"
        )
    return grid


def add_grid(parser: argparse.ArgumentParser) -> None:
    """Add the option --grid."""
    parser.add_argument(
        "--grid", metavar="ROWSxCOLUMNS", type=grid_of, help="the pad's rows and columns, as in 16x16"
    )


def ask_grid(console: Console, opened: Port) -> Grid | None:
    """Print the size of the pad's frames and ask for its rows and columns; None if no frames are found.

    Asks again if a grid does not fit the frames.
    """
    discard_input(opened)
    chunks = [Chunk(b"", time.monotonic()), *listen(opened, REST_S)]
    seen = survey(chunks)
    if seen is None:
        return None
    default = f" [{seen.grid[0]}x{seen.grid[1]}] ({seen.why})" if seen.grid else ""
    console.print(f"Your pad sends {seen.frame}, {seen.rate_hz:.0f} frames a second.")
    grid = None
    while grid is None:
        console.print(f"Rows and columns?{default} ", style="cyan", end="")
        if not (typed := sys.stdin.readline()):
            break
        try:
            grid = seen.grid if not typed.strip() and seen.grid else grid_of(typed)
        except argparse.ArgumentTypeError as error:
            console.print(str(error), style="yellow")
            continue
        if not any(placements(chunks, grid)):
            console.print(f"{seen.frame} do not fit {grid[0]}x{grid[1]} cells", style="yellow")
            grid = None
    # What arrived while the person typed is not complete.
    discard_input(opened)
    return grid


def find_with_a_hand(console: Console, opened: Port, grid: Grid | None) -> tuple[Finding, list[Chunk]]:
    """Ask for rest and for presses until the description is proven twice, or for PRESS_S.

    grid: asked for if None. Returns what was found, and what arrived before the presses.
    """
    grid = grid or ask_grid(console, opened)
    console.print(f"Leave the pad alone for {REST_S:g} s ...", style="cyan")
    # The empty chunk marks the start, so that silence before the first bytes counts as a pause.
    at_rest = [Chunk(b"", time.monotonic()), *listen(opened, REST_S)]
    chunks = [*at_rest]
    console.print(
        "Press firmly in the middle, then move your hand over the whole pad, to its edges ...", style="cyan"
    )
    until_s = time.monotonic() + PRESS_S
    before: Finding | None = None
    with ThreadPoolExecutor(1) as searching:
        while True:
            chunks += listen(opened, SEARCH_EVERY_S)
            search_now = searching.submit(search, tuple(chunks), grid)
            # Listen during the search too: a line that nobody reads loses frames.
            chunks += listen(opened, math.inf, lambda _: search_now.done())  # noqa: B023 - called in this turn
            finding = search_now.result()
            if (before and _is_again(finding, before)) or time.monotonic() >= until_s:
                return finding, at_rest
            before = finding


def find_without_asking(say: Callable[[str], None], opened: Port, grids: Sequence[Grid | None]) -> Finding:
    """Search what arrives while somebody may press the pad, for each of the grids; return the best."""
    say(f"press the pad: listening for {LISTEN_S:g} s ...")
    chunks = listen(opened, LISTEN_S)
    found = [search(chunks, grid) for grid in grids]
    if all(finding.proposed is None for finding in found) and any(finding.may_be_proven for finding in found):
        say(f"not proven yet, go on pressing: listening for {LONGER_S:g} s more ...")
        chunks += listen(opened, LONGER_S)
        found = [search(chunks, grid) for grid in grids]
    return max(found, key=lambda finding: (finding.proposed is not None, finding.may_be_proven))


def _is_again(finding: Finding, before: Finding) -> bool:
    """Whether two searches agree; the scale may grow with a firmer press.

    A single proof may be wrong while the hand has pressed only a part of the pad. Two failures agree if more
    presses cannot help.
    """
    found, earlier = finding.proposed, before.proposed
    if found is None or earlier is None:
        return found is earlier and not (finding.may_be_proven or before.may_be_proven)
    return replace(found, full_scale=earlier.full_scale) == earlier


def turned_with_a_hand(
    console: Console, opened: Port, described: PadFormat, at_rest: Sequence[Chunk]
) -> PadFormat | None:
    """Ask for the top left corner, then whether the picture follows; return the turned description.

    at_rest: what arrived before somebody pressed the pad. None if no picture followed: the grid or the corner
    was wrong.
    """
    console.print("Touch the corner that should be top left, and hold it ...", style="cyan")
    corner = _touched_corner(opened, described, at_rest)
    if corner is None:
        console.print("no corner was touched: sensor.turn and sensor.mirror are not set", style="yellow")
        return described
    choices = [replace(described, turn=turn, mirror=mirror) for turn, mirror in TURNS[corner]]
    for choice in choices:
        if _follows(console, opened, choice):
            return choice
    return None


def _touched_corner(opened: Port, described: PadFormat, at_rest: Sequence[Chunk]) -> tuple[bool, bool] | None:
    """Return the corner of the described pad that a hand holds, as (is below, is to the right)."""
    parser = FrameParser(described)
    # The hand may be on the pad already.
    rest = [frame.pressure for chunk in at_rest for frame in parser.feed(*chunk)]
    # When, at which row, at which column.
    held: list[tuple[float, float, float]] = []
    until_s = time.monotonic() + CORNER_S
    while time.monotonic() < until_s:
        for frame in parser.feed(read_waiting(opened, parser), time.monotonic()):
            rest = [*rest[-500:], frame.pressure]
            above = frame.pressure - np.percentile(np.array(rest), 20, axis=0)
            if len(rest) <= 10 or above.max() <= PRESSED_COUNTS:
                held = []
                continue
            rows, columns = np.nonzero(above > above.max() / 2)
            held.append((frame.host_s, float(rows.mean()), float(columns.mean())))
            latest = np.array([place for at_s, *place in held if at_s >= frame.host_s - HELD_S])
            if held[-1][0] - held[0][0] >= HELD_S and (np.ptp(latest, axis=0) <= HELD_TAXELS).all():
                row, column = latest.mean(axis=0)
                return bool(row > (ROWS - 1) / 2), bool(column > (COLUMNS - 1) / 2)
    return None


def _follows(console: Console, opened: Port, described: PadFormat) -> bool:
    """Show the pad and ask whether the picture follows the hand; return the answer."""
    parser = FrameParser(described)
    rest: NDArray[np.float64] | None = None
    shown_s = 0.0
    console.print("Move your hand on the pad. Does the picture follow it? [Y/n] ", style="cyan")
    with Live(console=console, auto_refresh=False, transient=True) as live:
        while not select.select([sys.stdin], [], [], 0)[0]:
            for frame in parser.feed(read_waiting(opened, parser), time.monotonic()):
                now = frame.pressure.astype(np.float64)
                rest = now if rest is None else np.minimum(rest + 0.05, now)
                if time.monotonic() - shown_s > SHOW_EVERY_S:
                    shown_s = time.monotonic()
                    live.update(Group(*pad_picture(now - rest, PICTURE_SCALE, console)), refresh=True)
    return not sys.stdin.readline().strip().lower().startswith("n")
