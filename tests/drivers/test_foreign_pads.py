"""What public sketches print, told its grid: the picture follows the hand, or the format is refused."""

import json
import struct
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from rigs.pressing import likeness, pressed

from touchd.drivers.search.listen import Chunk
from touchd.drivers.search.search import Finding, search

RATE_HZ = 50
Cells = NDArray[np.int_]
Printed = Callable[[Cells, int], str | bytes]
RNG = np.random.default_rng(3)


def found_in(
    printed: Callable[[int], str | bytes], grid: tuple[int, int] | None
) -> tuple[Finding, list[Chunk]]:
    """Search six seconds of frames that are printed at a steady rate."""
    sent = (printed(number) for number in range(6 * RATE_HZ))
    data = [each.encode() if isinstance(each, str) else each for each in sent]
    chunks = [Chunk(each, number / RATE_HZ) for number, each in enumerate(data)]
    return search(chunks, grid), chunks


def a_hand_on(rows: int, columns: int, top: int = 1023) -> Cells:
    return pressed(rows, columns, top, np.random.default_rng(2)).astype(np.int_)


def line(values: Cells, between: str = ",", end: str = "\r\n") -> str:
    return between.join(map(str, values.ravel().tolist())) + end


def table(values: Cells, between: str = ",") -> str:
    return "".join(line(row, between) for row in values)


def sent(values: Cells, kind: str) -> bytes:
    return values.astype(kind).tobytes()


def summed(data: bytes) -> bytes:
    return data + struct.pack("<H", sum(data) & 0xFFFF)


def to_and_fro(values: Cells) -> Cells:
    turned = values.copy()
    turned[1::2] = turned[1::2, ::-1]
    return turned


READ: dict[str, Printed] = {
    "commas": lambda v, n: line(v),
    "clock": lambda v, n: f"{20 * n + 7000},{line(v)}",
    "clock in microseconds": lambda v, n: f"{20_000 * n},{line(v)}",
    "clock and frame number": lambda v, n: f"{20 * n},{n},{line(v)}",
    "total": lambda v, n: f"{line(v, end='')},{v.sum()}\n",
    "centre and total": lambda v, n: f"{line(v, end='')},{v.sum(1) @ np.arange(8) / v.sum():.2f},{v.sum()}\n",
    "XOR": lambda v, n: f"{line(v, end='')}*{np.bitwise_xor.reduce(v.ravel()):03d}\n",
    "temperature": lambda v, n: f"{23 + n % 50 / 100:.2f},{line(v)}",
    "keys": lambda v, n: " ".join(f"s{i}={x}" for i, x in enumerate(v.ravel())) + "\r\n",
    "JSON": lambda v, n: json.dumps({"seq": n, "t": 20 * n, "p": v.tolist()}) + "\n",
    "JSON keys": lambda v, n: json.dumps({f"f{i}": int(x) for i, x in enumerate(v.ravel())}) + "\n",
    "volts": lambda v, n: " ".join(f"{x * 3.3 / 1023:.3f}" for x in v.ravel()) + "\r\n",
    "0x": lambda v, n: ", ".join(f"0x{x:03X}" for x in v.ravel()) + "\r\n",
    "signs": lambda v, n: " ".join(f"{x - 4:+d}" for x in v.ravel()) + "\r\n",
    "ROS": lambda v, n: f"header:\n  seq: {n}\ndata: {v.ravel().tolist()}\n---\n",
    "board's log": lambda v, n: f"\x1b[0;32mI ({20 * n}) pad: {line(v, ' ', chr(27) + '[0m')}\r\n",
    "log between": lambda v, n: line(v) + "wifi: rssi -61, heap 182344\r\n" * (n % 20 == 7),
    "rows and blank": lambda v, n: f"{table(v)}\r\n",
    "rows and a word": lambda v, n: f"{table(v, ' ')}-----\r\n",
    "rows, numbered": lambda v, n: "".join(f"{i}\t{line(r)}" for i, r in enumerate(v)),
    "rows, labelled": lambda v, n: "".join(f"Row {i}: {line(r)}" for i, r in enumerate(v)) + "\r\n",
    "rows with sums": lambda v, n: "".join(f"{line(r, end='')};{r.sum()}\r\n" for r in v) + "\r\n",
    "two rows a line": lambda v, n: table(v.reshape(4, -1)) + "\r\n",
    "a cell a line": lambda v, n: "".join(f"A{i}: {x}\r\n" for i, x in enumerate(v.ravel())),
    "offset": lambda v, n: line(v + 300),
    "inverted": lambda v, n: line(1023 - v),
    "falls from the middle": lambda v, n: line(500 - v * 2 // 5),
    "falls from a tenth": lambda v, n: line(80 - v // 9),
    "rises from the upper half": lambda v, n: line(600 + v * 2 // 5),
    "u8": lambda v, n: b"\xaa\x55" + sent(v // 5, "u1"),
    "u8 and a footer": lambda v, n: sent(v // 5 + 14, "u1") + b"\r\n",
    "u8, counter, sum": lambda v, n: b"\xaa\x55" + summed(bytes([n % 256]) + sent(v // 5, "u1")),
    "u16": lambda v, n: b"\xaa\x55" + sent(v, "<u2"),
    "u16, big": lambda v, n: b"\xaa\x55" + sent(v, ">u2"),
    "u16, small values": lambda v, n: b"\xaa\x55" + struct.pack("<I", 20 * n) + sent(v // 5, "<u2"),
    "u16, clock": lambda v, n: b"\xff\xff\xff\xff" + struct.pack("<I", 20 * n) + sent(v, "<u2"),
    "u16, length, sum": lambda v, n: b"\x55\xaa" + summed(struct.pack("<HH", 160, 7) + sent(v, "<u2")),
    "u16, 64-bit clock": lambda v, n: b"\x55\xaa" + struct.pack("<Q", 10**8 + 20_000 * n) + sent(v, "<u2"),
    "u16, big counter": lambda v, n: b"\x55\xaa" + struct.pack(">I", n) + sent(v, ">u2"),
    "i8": lambda v, n: b"\xa5\x5a" + sent(v // 9 - RNG.integers(0, 3, v.shape), "i1"),
    "i16": lambda v, n: b"\xa5\x5a" + sent(v - 4, "<i2"),
    "16-bit converter": lambda v, n: b"\xa5\x5a" + sent(60 * v + RNG.integers(0, 30, v.shape), "<u2"),
    "16-bit converter, offset": lambda v, n: (
        b"\xa5\x5a" + sent(12_000 + 12 * v + RNG.integers(0, 40, v.shape), "<u2")
    ),
    "f32": lambda v, n: b"\xaa\x55\xaa\x55" + sent(v / 1023, "<f4"),
}
REFUSED: dict[str, Printed | tuple[Printed, str]] = {
    "bare rows": (lambda v, n: table(v), "empty line"),
    "hexadecimal": lambda v, n: " ".join(f"{x:03X}" for x in v.ravel()) + "\r\n",
    "hexadecimal pairs": lambda v, n: " ".join(f"{x // 4:02x}" for x in v.ravel()) + "\r\n",
    "below 0": (lambda v, n: line(v - 512), "below 0"),
    "falls below 0": (lambda v, n: line(-v), "below 0"),
    "decimal commas": lambda v, n: ";".join(f"{x // 9},{x % 9}" for x in v.ravel()) + "\n",
    "row and column beside": lambda v, n: "".join(f"{i // 9},{i % 9},{x}\n" for i, x in enumerate(v.flat)),
    "row numbers inside": lambda v, n: (
        json.dumps([{"row": i + 1, "v": r.tolist()} for i, r in enumerate(v)]) + "\n"
    ),
    "rows to and fro": (lambda v, n: line(to_and_fro(v)), "another order"),
    "even rows first": (lambda v, n: line(np.concatenate([v[::2], v[1::2]])), "another order"),
    "lower half first": (lambda v, n: line(np.roll(v, 4, axis=0)), "another order"),
    "left half first": (lambda v, n: line(v[:, :5], end=",") + line(v[:, 5:]), "another order"),
    "bytes between rows": (
        lambda v, n: b"\xaa\x55" + b"".join(sent(r, "<u2") + b"\0\0" for r in v),
        "another order",
    ),
    "half floats": (lambda v, n: b"\xaa\x55" + sent(v / 1023, "<f2"), "half floats"),
    "pads by turns": (lambda v, n: line(v) + line(v[::-1, ::-1]), "two pads"),
    "a clock inside": lambda v, n: f"{line(v[:4], end=f',{20 * n},')}{line(v[4:])}",
    "two pads": (lambda v, n: line(v, end=" | ") + line(v), "160 numbers a frame, which do not fit 8x10"),
    "raw and filtered": (lambda v, n: line(np.stack([v, v * 3 // 4], -1)), "160 numbers"),
    "changes": lambda v, n: line(np.rint(90 * np.sin(n / 3) * v / 1023).astype(np.int_)),
    "u12": lambda v, n: b"\xaa\x55" + bytes(120),
    "u32": lambda v, n: b"\xaa\x55" + sent(v, "<u4"),
    "low bytes": (lambda v, n: b"\xf0\xaa\x55" + sent(v & 255, "u1"), "jump"),
    "a packet a row": lambda v, n: b"".join(bytes([170, i]) + sent(r // 5, "u1") for i, r in enumerate(v)),
    "half a packet": lambda v, n: (
        b"\xaa\x55\0" + sent(v[:4] // 5, "u1") + b"\xaa\x55\1" + sent(v[4:] // 5, "u1")
    ),
    "no header": lambda v, n: sent(v // 5, "u1"),
}


def picture_of(printed: Printed, values: Cells) -> float:
    """Return how well what the proposed format reads resembles the pad's cells, from 0 to 1."""
    finding, chunks = found_in(lambda number: printed(values[number], number), values.shape[1:])
    assert finding.proposed is not None, finding.missing
    return likeness(finding.proposed, chunks, values)


def tabled(table: dict[str, Any]) -> list[Any]:
    """Return the rows of a table as parameters; the quick suite takes every other row."""
    return [
        pytest.param(row, id=name, marks=[pytest.mark.slow] * (number % 2))
        for number, (name, row) in enumerate(table.items())
    ]


@pytest.mark.parametrize("printed", tabled(READ))
def test_the_picture_follows_the_hand(printed: Printed) -> None:
    assert picture_of(printed, a_hand_on(8, 10)) > 0.97


@pytest.mark.parametrize("row", tabled(REFUSED))
def test_what_cannot_be_read_is_refused(row: Printed | tuple[Printed, str]) -> None:
    printed, missing = row if isinstance(row, tuple) else (row, "")
    values = a_hand_on(8, 10)
    finding, _ = found_in(lambda number: printed(values[number], number), (8, 10))
    assert finding.proposed is None
    assert missing in finding.missing


@pytest.mark.parametrize(("rows", "columns"), [(4, 4), (64, 4), (4, 64)])
def test_grids_of_the_shortest_and_longest_sides_are_read(rows: int, columns: int) -> None:
    assert picture_of(lambda v, n: line(v), a_hand_on(rows, columns)) > 0.97


def test_sums_after_short_rows_are_not_cells() -> None:
    assert picture_of(READ["rows with sums"], a_hand_on(16, 8)) > 0.97
    closed = a_hand_on(10, 4)
    assert picture_of(lambda v, n: READ["rows with sums"](v, n).rstrip() + "]\r\n", closed) > 0.97


def test_a_grid_that_is_sent_column_by_column_is_turned() -> None:
    values = a_hand_on(8, 10)
    proposed = found_in(lambda number: line(values[number].T), (8, 10))[0].proposed
    assert proposed is not None
    assert (proposed.rows, proposed.columns) == (10, 8)


@pytest.mark.parametrize("told", [(5, 16), (16, 5), (4, 20)])
def test_another_grid_of_as_many_cells_is_refused(told: tuple[int, int]) -> None:
    values = a_hand_on(8, 10)
    finding, _ = found_in(lambda number: line(values[number]), told)
    assert finding.proposed is None
    assert "is the grid right?" in finding.missing


def test_without_a_grid_only_rows_and_presets_are_read() -> None:
    values = a_hand_on(12, 10)
    rows, _ = found_in(lambda number: table(values[number]) + "\r\n", None)
    assert rows.proposed is not None
    assert (rows.proposed.rows, rows.proposed.columns) == (12, 10)
    flat, _ = found_in(lambda number: line(values[number]), None)
    assert flat.proposed is None
    assert flat.missing == "120 numbers a frame; say --grid ROWSxCOLUMNS"


def test_a_slow_pad_is_refused_with_its_rate() -> None:
    values = a_hand_on(8, 8)
    chunks = [Chunk(line(each).encode(), number / 5) for number, each in enumerate(values[::4])]
    missing = search(chunks, (8, 8)).missing
    assert missing.endswith("; 5.0 frames/s come, pausing for up to 0.2 s; 8 to 500 are needed")
    steady = [Chunk(line(each).encode(), number / 8.1) for number, each in enumerate(values[::3])]
    assert search(steady, (8, 8)).proposed is not None


@pytest.mark.parametrize(("clock", "missing"), [(False, "bursts"), (True, "")])
def test_a_pad_that_sends_in_bursts_needs_a_clock(clock: bool, missing: str) -> None:
    values = a_hand_on(8, 8)
    sent = [(f"{20 * number + 7000}," * clock + line(each)).encode() for number, each in enumerate(values)]
    bursts = [Chunk(b"".join(sent[first : first + 25]), first / RATE_HZ) for first in range(0, len(sent), 25)]
    finding = search(bursts, (8, 8))
    assert (finding.proposed is None) == bool(missing)
    assert missing in finding.missing


def waves(number: int, channels: int, speed: float) -> NDArray[np.float64]:
    at_s = number / RATE_HZ
    return np.array([np.sin(speed * at_s * (1 + 0.07 * each) + each) for each in range(channels)])


NO_PADS: dict[str, Callable[[int], str | bytes]] = {
    "IMU": lambda n: f"{20 * n},{','.join(f'{x:.3f}' for x in 9.8 * waves(n, 18, 5))}\r\n",
    "IMU, shaken at times": lambda n: (
        " ".join(f"{x:.3f}" for x in (n % 150 > 90) * waves(n, 16, 9) + RNG.normal(0, 0.01, 16)) + "\n"
    ),
    "IMU in floats": lambda n: b"\xa5\x5a" + (9.8 * waves(n, 16, 4)).astype("<f4").tobytes(),
    "16 channels": lambda n: line((512 + 200 * waves(n, 16, 3) + RNG.normal(0, 2, 16)).astype(np.int_)),
    "64 channels": lambda n: line((512 + 200 * waves(n, 64, 3) + RNG.normal(0, 2, 64)).astype(np.int_)),
    "GPS": lambda n: f"$GPGSV,3,1,{','.join(map(str, RNG.integers(0, 90, 16)))}*74\r\n",
    "nothing": lambda n: b"",
    "random": lambda n: RNG.bytes(140),
    "zeros": lambda n: b"\0" * 160,
    "ones": lambda n: b"\xff" * 160,
    "MP3": lambda n: b"\xff\xfb\x90\x00" + RNG.bytes(413 + (n % 3 == 0)),
    "sound": lambda n: (8000 * np.sin(np.arange(40 * n, 40 * n + 40) / 9)).astype("<i2").tobytes(),
    "empty lines": lambda n: b"\r\n" * 13,
    "words": lambda n: b"Booting...\r\nwifi connected, rssi -60\r\n" * 3,
    "joints": lambda n: struct.pack("<BI", 170, n) + (2000 * waves(n, 24, 2)).astype("<i2").tobytes(),
}


MORE_GRIDS = [pytest.param(grid, marks=pytest.mark.slow) for grid in [(4, 6), (8, 8), (16, 16)]]


@pytest.mark.parametrize("printed", NO_PADS.values(), ids=NO_PADS)
@pytest.mark.parametrize("grid", [None, (4, 4), *MORE_GRIDS])
def test_other_sensors_are_not_taken_for_pads(
    printed: Callable[[int], str | bytes], grid: tuple[int, int] | None
) -> None:
    finding, _ = found_in(printed, grid)
    assert finding.proposed is None
    assert finding.missing
