"""What public sketches and boards print: a pad's grid is found or refused, nothing else is taken for one."""

import json
import math
import struct
from collections.abc import Callable
from itertools import product

import numpy as np
import pytest
from numpy.typing import NDArray
from rigs.pressing import pressed

from touchd.drivers.search.search import Chunk, Finding, search

RATE_HZ = 50
Grid = NDArray[np.int_]
RNG = np.random.default_rng(3)


def found_in(printed: Callable[[int], str | bytes], frames: int = 5 * RATE_HZ) -> Finding:
    """Return what a search finds in frames that are printed at a steady rate."""
    sent = (printed(number) for number in range(frames))
    data = [each.encode() if isinstance(each, str) else each for each in sent]
    return search([Chunk(each, number / RATE_HZ) for number, each in enumerate(data)])


def a_hand_on(rows: int, columns: int, top: int = 1023) -> Grid:
    return pressed(rows, columns, top, np.random.default_rng(2)).astype(np.int_)


def line(values: Grid, between: str = ",") -> str:
    return between.join(map(str, values.ravel().tolist()))


def table(values: Grid, between: str = ",") -> str:
    return "".join(f"{line(row, between)}\r\n" for row in values)


TEXTS: dict[str, Callable[[Grid, int], str]] = {
    "plotter": lambda v, n: "\t".join(f"s{i}:{x}" for i, x in enumerate(v.ravel())) + "\r\n",
    "JSON keys": lambda v, n: json.dumps({f"f{i}": int(x) for i, x in enumerate(v.ravel())}) + "\n",
    "date and time": lambda v, n: f"2026-11-25T10:00:{n / 50:06.3f}Z,{line(v)}\n",
    "six leading numbers": lambda v, n: f"1,2,3,4,5,{n},{line(v)}\n",
    "eight numbers on either side": lambda v, n: f"1,2,3,4,5,6,7,{n},{line(v)}{8 * ',0.71'}\n",
    "pressure map": lambda v, n: f"Frame,{n}\r\nTime,{n / 50:.2f}\r\nRaw Sum,{v.sum()}\r\n{table(v)}@@\r\n",
    "ROS": lambda v, n: f"header:\n  seq: {n}\n  secs: {n // 50}\ndata: {v.ravel().tolist()}\n---\n",
    "0x": lambda v, n: ", ".join(f"0x{x:03X}" for x in v.ravel()) + "\r\n",
    "signs": lambda v, n: " ".join(f"{x - 4:+d}" for x in v.ravel()) + "\r\n",
    "percent": lambda v, n: " ".join(f"{x / 10.23:.1f}%" for x in v.ravel()) + "\r\n",
    "exponents": lambda v, n: " ".join(f"{x * 1e-3:.4e}" for x in v.ravel()) + "\n",
    "tiny exponents": lambda v, n: " ".join(f"{x * 1e-9:.3e}" for x in v.ravel()) + "\n",
    "total": lambda v, n: f"{line(v)},{v.sum()}\n",
    "a cell that fails": lambda v, n: (
        " ".join("NaN" if i == 33 else f"{x}" for i, x in enumerate(v.ravel())) + "\r\n"
    ),
    "a cell that is null": lambda v, n: json.dumps([None, *v.ravel().tolist()[1:]]) + "\n",
    "ruled table": lambda v, n: "".join(f"R{i} | {line(r, ' ')} |\r\n" for i, r in enumerate(v)) + "----\r\n",
}


@pytest.mark.parametrize("printed", TEXTS.values(), ids=TEXTS)
def test_grids_printed_as_plain_text_are_read(printed: Callable[[Grid, int], str]) -> None:
    values = a_hand_on(8, 10)
    proposed = found_in(lambda number: printed(values[number], number)).proposed
    assert proposed is not None
    assert (proposed.rows, proposed.columns, proposed.invert) == (8, 10, False)


@pytest.mark.parametrize(("rows", "columns"), [(64, 4), (4, 64)])
def test_a_grid_of_the_longest_side_is_found(rows: int, columns: int) -> None:
    values = a_hand_on(rows, columns)
    proposed = found_in(lambda number: f"{line(values[number])}\n", 4 * RATE_HZ).proposed
    assert proposed is not None
    assert (proposed.rows, proposed.columns) == (rows, columns)


def wrapped(values: Grid, width: int) -> str:
    """Print as many cells on a line as fit."""
    cells = values.ravel()
    return "".join(f"{line(cells[at : at + width])}\r\n" for at in range(0, cells.size, width))


@pytest.mark.parametrize(("columns", "width"), [(5, 10), (8, 4)])
def test_lines_that_are_not_rows_are_read_as_the_better_grid(columns: int, width: int) -> None:
    values = a_hand_on(8, columns)
    proposed = found_in(lambda number: wrapped(values[number], width) + "\r\n").proposed
    assert proposed is not None
    assert (proposed.rows, proposed.columns) == (8, columns)


@pytest.mark.parametrize("width", [9, 15])
def test_cells_left_for_a_shorter_line_are_not_ignored(width: int) -> None:
    values = a_hand_on(8, 8)
    finding = found_in(lambda number: wrapped(values[number], width) + "\r\n", 3 * RATE_HZ)
    assert finding.proposed is None
    assert "beside its cells" in finding.missing


def test_frames_between_two_other_lines_are_not_rows() -> None:
    values = a_hand_on(5, 5)
    temperature = "T 24.5\r\n"
    proposed = found_in(
        lambda number: f"{line(values[number])}\r\n{temperature * (number % 5 == 0)}"
    ).proposed
    assert proposed is not None
    assert (proposed.rows, proposed.columns) == (5, 5)


def around(values: Grid, row: NDArray[np.int_]) -> str:
    return f"{table(values)}{line(row)}\r\n\r\n"


REST = np.random.default_rng(4).integers(18_000, 23_000, (8, 10))
UNPROVEN: dict[str, tuple[Callable[[Grid, int], str], str]] = {
    "column sums": (lambda v, n: around(v, v.sum(0)), "total"),
    "column sums first": (lambda v, n: f"{line(v.sum(0))},{line(v)}\r\n", "total"),
    "column means": (lambda v, n: around(v, v.mean(0).astype(np.int_)), "total"),
    "column maxima": (lambda v, n: f"{line(v)},{line(v.max(0))}\r\n", "maximum"),
    "row sums": (lambda v, n: f"{table(np.hstack([v, v.sum(1)[:, None]]))}\r\n", "total"),
    "a dead first row": (lambda v, n: f"{line(v * (np.arange(8) > 0)[:, None])}\r\n", "beside its cells"),
    "dead last columns": (lambda v, n: f"{table(v * (np.arange(10) < 8))}\r\n", "does not move"),
    "large offsets": (lambda v, n: f"{line(REST + v)}\r\n", "full_scale by hand"),
    "large offsets, falling": (lambda v, n: f"{line(REST - v)}\r\n", "full_scale by hand"),
    "numbers that are too large": (lambda v, n: f"{line(v * 20_000_000)}\r\n", "usual size"),
    "numbers that are too small": (lambda v, n: " ".join(f"{x}e-40" for x in v.ravel()) + "\n", "usual size"),
    "few levels": (lambda v, n: f"{line(v // 50)}\r\n", "full_scale by hand"),
    "nine angles": (lambda v, n: f"{line(v)}{9 * ',0.71'}{n % 7}\r\n", "fraction"),
    "a column of dashes": (
        lambda v, n: "".join(f"{line(r[:3], ' ')}  --  {line(r[3:], ' ')}\r\n" for r in v) + "\r\n",
        "dashes",
    ),
    "three axes": (lambda v, n: f"{line(np.vstack([v * n % 7 - v, v - v * n % 5, v]))}\r\n", "move"),
}


def in_hex(values: Grid) -> str:
    return " ".join(f"{16 + each // 8:02x}" for each in values.ravel())


def ohms(value: int) -> str:
    return f"{1000 / (value + 1):.1f}k" if value < 1000 else f"{1e6 / (value + 1):.0f}"


def summed(row: NDArray[np.int_], modulus: int) -> str:
    return f"{line(row)};{row.sum() % modulus}\r\n"


def xored(row: NDArray[np.int_]) -> str:
    return f"{line(row)},{np.bitwise_xor.reduce(row)}\r\n"


def beside(one: Grid, other: Grid) -> str:
    """Print the cells of two grids alternately."""
    return f"{line(np.stack([one, other], axis=-1))}\r\n"


def untouched(rows: int, columns: int) -> Grid:
    return RNG.integers(2, 5, (rows, columns))


MISREAD: dict[str, tuple[Callable[[Grid, int], str], str]] = {
    "two hexadecimal digits": (lambda v, n: f"{in_hex(v)}\r\n", "hexadecimal"),
    "hexadecimal rows": (
        lambda v, n: "".join(f"R{i}: {in_hex(r)}\n" for i, r in enumerate(v)),
        "hexadecimal",
    ),
    "ohms and kilo-ohms": (lambda v, n: ",".join(map(ohms, (4 * v).ravel())) + "\r\n", "units"),
    "decimal commas": (
        lambda v, n: ";".join(f"{x / 100:.2f}".replace(".", ",") for x in v.ravel()) + "\n",
        "commas",
    ),
    "a print that leaves out the middle": (
        lambda v, n: "".join(f"[{line(r[:3], ' ')} ... {line(r[-3:], ' ')}]\n" for r in v[:6]) + "\n",
        "dots",
    ),
    "raw and filtered": (lambda v, n: beside(v, v * 3 // 4), "kinds"),
    "rows raw and filtered": (
        lambda v, n: "".join(f"{line(r + 40)}\r\n{line(r // 2)}\r\n" for r in v) + "\r\n",
        "kinds",
    ),
    "raw, baseline and difference": (
        lambda v, n: f"{line(np.stack([v + 300, 0 * v + 303, v], axis=-1))}\r\n",
        "kinds",
    ),
    "rows of two pads by turns": (
        lambda v, n: "".join(f"L: {line(a)}\nR: {line(b)}\n" for a, b in zip(v, v[::-1], strict=True)) + "\n",
        "",
    ),
    "a second pad that nobody touches": (lambda v, n: f"{line(v)},{line(untouched(8, 10))}\r\n", "press"),
    "a second pad beside it": (lambda v, n: f"{table(np.hstack([v, untouched(8, 10)]))}\r\n", "press"),
    "three rows without a wire": (lambda v, n: f"{table(v)}{table(untouched(3, 10))}\r\n", "press"),
    "a sum of 8 bits a row": (lambda v, n: "".join(summed(r, 256) for r in v) + "\r\n", "checksum"),
    "a sum of two digits a row": (lambda v, n: "".join(summed(r, 100) for r in v) + "\r\n", "checksum"),
    "an XOR a row": (lambda v, n: "".join(map(xored, v)) + "\r\n", "checksum"),
    "column sums, then row sums": (
        lambda v, n: f"{line(v[:, :8])},{line(v[:, :8].sum(0))},{line(v[:, :8].sum(1))}\n",
        "total",
    ),
    "a number that jumps first": (lambda v, n: f"{RNG.integers(300, 700)},{line(v)}\n", "clock"),
}


@pytest.mark.parametrize(
    ("printed", "missing"), [*UNPROVEN.values(), *MISREAD.values()], ids=[*UNPROVEN, *MISREAD]
)
def test_an_unproven_or_misread_grid_is_refused_with_a_reason(
    printed: Callable[[Grid, int], str], missing: str
) -> None:
    values = a_hand_on(8, 10)
    finding = found_in(lambda number: printed(values[number], number))
    assert finding.proposed is None
    assert missing in finding.missing


def test_changes_of_pressure_are_not_taken_for_pressure() -> None:
    values = a_hand_on(8, 10)
    finding = found_in(lambda number: f"{line(values[number + 1] - values[number])}\n")
    assert finding.proposed is None


def test_a_pad_that_is_silent_at_rest_is_refused() -> None:
    values = a_hand_on(8, 10)
    chunks = [
        Chunk(f"{line(each)}\n".encode(), number / RATE_HZ)
        for number, each in enumerate(values)
        if number % 150 > 90 or number < 2
    ]
    finding = search(chunks)
    assert finding.proposed is None
    assert "while nothing presses it" in finding.missing


def with_distances(data: bytes) -> bytes:
    """Return a frame in COBS: each zero is replaced by the distance to the next one."""
    return b"".join(bytes([len(part) + 1]) + part for part in data.split(b"\0")) + b"\0"


def test_cobs_encoded_cells_are_refused_by_name() -> None:
    values = (a_hand_on(8, 8) - 2).astype("<u2")
    finding = found_in(lambda number: with_distances(values[number].tobytes()))
    assert finding.proposed is None
    assert "COBS" in finding.missing


def test_signed_bytes_are_not_taken_for_a_pad_upside_down() -> None:
    values = (a_hand_on(8, 8, 120) - 10).astype("i1")
    finding = found_in(lambda number: b"\xaa\x55" + values[number].tobytes())
    assert finding.proposed is None
    assert "signed" in finding.missing


def split(values: Grid, at: int, mark: int = 0) -> bytes:
    return b"".join(bytes([each // at, mark + each % at]) for each in values.ravel().tolist())


def nibbles(values: Grid) -> bytes:
    four_bits = values // 64
    return (four_bits[:, ::2] << 4 | four_bits[:, 1::2]).astype("u1").tobytes()


OTHER_CELLS: dict[str, tuple[Callable[[Grid], bytes], str]] = {
    "seven bits a byte": (lambda v: split(v, 128), "bits"),
    "six bits, marked": (lambda v: split(v, 64, 64), "bits"),
    "four bits": (nibbles, "two cells"),
    "lower bytes": (lambda v: (v & 0xFF).astype("u1").tobytes(), "lower halves"),
    "lower bytes, then upper ones": (
        lambda v: (v & 0xFF).astype("u1").tobytes() + (v >> 8).astype("u1").tobytes(),
        "nothing but its cells",
    ),
}


@pytest.mark.parametrize(("cells", "missing"), OTHER_CELLS.values(), ids=OTHER_CELLS)
def test_cells_of_a_kind_that_is_not_read_are_refused(cells: Callable[[Grid], bytes], missing: str) -> None:
    values = a_hand_on(8, 8)
    finding = found_in(lambda number: b"\xf0\xaa\x55" + cells(values[number]))
    assert finding.proposed is None
    assert missing in finding.missing


def test_a_centre_of_pressure_is_not_taken_for_cells() -> None:
    def printed(number: int) -> str:
        v = values[number]
        down, right = v.sum(1) @ np.arange(8) / v.sum(), v.sum(0) @ np.arange(10) / v.sum()
        return f"{line(v)},{down:.2f},{right:.2f},{v.sum()}\r\n"

    values = a_hand_on(8, 10)
    proposed = found_in(printed).proposed
    assert proposed is not None
    assert (proposed.rows, proposed.skip, proposed.tail, proposed.full_scale) == (8, 0, 3, 1023)


@pytest.mark.parametrize("is_inverted", [False, True])
def test_a_hand_that_hardly_lets_go_does_not_prove_polarity(is_inverted: bool) -> None:
    y, x = np.mgrid[0:8, 0:8]
    rng = np.random.default_rng(3)

    def printed(number: int) -> str:
        at_s = number / RATE_HZ
        down, right = 3.5 + 0.3 * math.sin(2 * at_s), 3.5 + 0.3 * math.cos(2.6 * at_s)
        hand = 400 * np.exp(-(((y - down) / 3) ** 2) - ((x - right) / 3) ** 2)
        hand *= (at_s % 2 < 1.5) * (1 + 0.05 * math.sin(7 * at_s))
        values = (rng.integers(0, 3, (8, 8)) + hand).astype(np.int_)
        return f"{line(1023 - values if is_inverted else values)}\r\n"

    finding = found_in(printed)
    assert finding.proposed is None
    assert "let go" in finding.missing


CONSTANTS = [bytes(10), bytes([3, 4] * 5), bytes([0, 255, 255] * 3), bytes(range(50, 60)), b"\2"]
CELLS = {"u1": (8, 5), "<u2": (5, 4), ">i2": (6, 4)}
PLACED = list(product(CELLS, CONSTANTS, CONSTANTS))


def check_constants(cell: str, before: bytes, after: bytes) -> None:
    rows, columns = CELLS[cell]
    values = a_hand_on(rows, columns, 120 if cell == "u1" else 1023).astype(cell)
    proposed = found_in(lambda number: b"\xaa" + before + values[number].tobytes() + after).proposed
    assert proposed is None or (proposed.rows, proposed.columns) == (rows, columns)
    if len(before) == len(after) == 1:
        assert proposed is not None


# Every seventh combination still has each constant both before and after cells.
SOME = [*PLACED[::7], ("<u2", b"\2", b"\2"), (">i2", b"\2", b"\2")]


@pytest.mark.parametrize(("cell", "before", "after"), SOME)
def test_constant_bytes_are_not_taken_for_cells(cell: str, before: bytes, after: bytes) -> None:
    check_constants(cell, before, after)


@pytest.mark.slow
@pytest.mark.parametrize(("cell", "before", "after"), PLACED)
def test_no_constant_bytes_around_any_cells_are_taken_for_cells(
    cell: str, before: bytes, after: bytes
) -> None:
    check_constants(cell, before, after)


def test_a_counters_upper_bytes_are_not_in_the_header() -> None:
    values = a_hand_on(6, 5, 250).astype("u1")
    proposed = found_in(
        lambda number: b"\xaa\x55" + struct.pack(">I", number) + values[number].tobytes()
    ).proposed
    assert proposed is not None
    assert (proposed.header, proposed.rows, proposed.columns) == ("aa55", 6, 5)


@pytest.mark.parametrize(
    ("before", "after"), [(">I", ""), ("", "<I"), (">I", "<H")], ids=["big", "little", "both"]
)
def test_a_counters_upper_bytes_that_rest_are_not_in_the_header(before: str, after: str) -> None:
    values = a_hand_on(6, 6).astype("<u2")

    def printed(number: int) -> bytes:
        return b"\xaa\x55%b%b%b" % (
            struct.pack(before, *[200_000 + 20 * number] * bool(before)),
            values[number].tobytes(),
            struct.pack(after, *[60_000 + number] * bool(after)),
        )

    proposed = found_in(printed).proposed
    assert proposed is not None
    assert (proposed.header, proposed.rows, proposed.columns) == ("aa55", 6, 6)


@pytest.mark.parametrize("cell", ["<u2", ">u2"])
def test_busy_lower_bytes_do_not_hide_the_byte_order(cell: str) -> None:
    rng = np.random.default_rng(5)
    noisy = pressed(6, 5, 30_000, rng) + rng.uniform(900, 2900, (6, 5)) + rng.normal(0, 150, (400, 6, 5))
    values = noisy.astype(cell)
    proposed = found_in(lambda number: b"\xaa\xab" + values[number].tobytes()).proposed
    assert proposed is not None
    assert (proposed.order == "little", proposed.skip, proposed.tail) == (cell == "<u2", 0, 0)


def test_dead_cells_do_not_hide_the_header() -> None:
    values = a_hand_on(6, 8).astype("<u2")
    values[:, [1, 3, 4], [3, 5, 1]] = 0
    proposed = found_in(lambda number: b"\xaa\x55" + values[number].tobytes()).proposed
    assert proposed is not None
    assert (proposed.header, proposed.rows, proposed.columns) == ("aa55", 6, 8)


@pytest.mark.parametrize(("unit", "full_scale"), [(1023, 1), (204, 5), (10.23, 100)])
def test_a_fractions_full_scale_leaves_room_for_a_firmer_press(unit: float, full_scale: float) -> None:
    values = a_hand_on(5, 5)
    proposed = found_in(
        lambda number: " ".join(f"{x / unit:.3f}" for x in values[number].ravel()) + "\n"
    ).proposed
    assert proposed is not None
    assert proposed.full_scale == full_scale


def test_row_numbers_in_a_line_are_not_a_column() -> None:
    values = a_hand_on(8, 8)
    rows = [[{"row": row, "values": each.tolist()} for row, each in enumerate(frame)] for frame in values]
    assert found_in(lambda number: json.dumps(rows[number]) + "\n").proposed is None


def test_the_user_is_asked_to_press_an_untouched_row() -> None:
    values = a_hand_on(8, 5)
    values[values < 20] = 3
    values[:, 6:] = 3
    finding = found_in(lambda number: f"{line(values[number])}\n")
    assert finding.proposed is None
    assert "press" in finding.missing or "equally" in finding.missing


def waves(number: int, channels: int, speed: float) -> NDArray[np.float64]:
    at_s = number / RATE_HZ
    return np.array([math.sin(speed * at_s * (1 + 0.07 * each) + each) for each in range(channels)])


def bump(number: int, width: int, size: float) -> Grid:
    """Return a bump that wanders along a line of detectors."""
    place = width / 2 + 0.4 * width * math.sin(number / 25)
    near = 1000 * np.exp(-(((np.arange(width) - place) / size) ** 2))
    return (near + RNG.integers(0, 5, width)).astype(np.int_)


NO_PADS: dict[str, Callable[[int], str | bytes]] = {
    "IMU": lambda n: f"{20 * n},{','.join(f'{x:.3f}' for x in 9.8 * waves(n, 18, 5))}\r\n",
    "IMU in floats": lambda n: b"\xa5\x5a" + (9.8 * waves(n, 16, 4)).astype("<f4").tobytes(),
    "16 channels": lambda n: (
        line((512 + 200 * waves(n, 16, 3) + RNG.normal(0, 2, 16)).astype(np.int_)) + "\n"
    ),
    "GPS": lambda n: f"$GPGSV,3,1,{','.join(map(str, RNG.integers(0, 90, 16)))}*74\r\n",
    "LIDAR": lambda n: line(2000 - bump(n, 64, 5)) + "\r\n",
    "spectrum": lambda n: line(bump(n, 256, 12)) + "\r\n",
    "touch strip": lambda n: "DIFF: " + line(bump(n, 24, 1.2), " ") + "\r\n",
    "line camera": lambda n: b"\xff\0" + bump(n, 128, 8).astype("<u2").tobytes(),
    "sound levels": lambda n: " ".join(f"{-60 + 50 * abs(x):.1f}" for x in waves(n, 32, 2.3)) + "\n",
    "servos": lambda n: (
        ",".join(f"{2048 + 600 * x:.0f},{RNG.integers(-50, 50)},40" for x in waves(n, 18, 1)) + "\n"
    ),
    "coloured lights": lambda n: (
        b"\x7e\6\1\2\0"
        + bytes(int(255 * max(0, math.sin(i // 3 / 5 - 0.08 * n + i % 3))) for i in range(510))
        + b"\xe7"
    ),
    "joints": lambda n: struct.pack("<BI", 170, n) + (2000 * waves(n, 24, 2)).astype("<i2").tobytes(),
}


# The longest frames take longest.
SENSORS = [
    pytest.param(printed, id=name, marks=[pytest.mark.slow] if name == "coloured lights" else [])
    for name, printed in NO_PADS.items()
]


@pytest.mark.parametrize("printed", SENSORS)
def test_other_sensors_are_not_taken_for_pads(printed: Callable[[int], str | bytes]) -> None:
    finding = found_in(printed)
    assert finding.proposed is None
    assert finding.missing
