"""The firmware on a simulated board: pin values arrive as frames at 54 Hz, without loss."""

import re
import shutil
import subprocess
from collections.abc import Callable
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from rigs.formats import FabricGrid
from rigs.mega_rig import (
    FIRMWARE,
    SKETCH,
    Board,
    Run,
    build,
    build_board,
    simulator_missing,
)

from touchd.drivers.frame import FRAME_RATE_HZ, MAX_COUNT, Frame

TEENSY = Path(__file__).parents[1] / "rigs" / "simulated_teensy"
PERIOD_MS = 1000 / FRAME_RATE_HZ
RUN_S = 1.0
MakeBoard = Callable[..., Board]


def pictures_of(rows: int, columns: int, count: int = 300) -> NDArray[np.uint16]:
    """Return random raw values for each scan; the first two are all minimum and all maximum."""
    pictures = np.random.default_rng(7).integers(0, MAX_COUNT + 1, (count, rows, columns)).astype(np.uint16)
    pictures[0], pictures[1] = 0, MAX_COUNT
    return pictures


def parser_for(rows: int) -> FabricGrid:
    return FabricGrid(rows=rows, columns=rows, crop=(rows - 8) // 2)


def steps_ms(frames: list[Frame]) -> NDArray[np.int64]:
    return np.diff([frame.sensor_ms for frame in frames])


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("firmware")


@pytest.fixture(scope="module")
def board(folder: Path) -> MakeBoard:
    """A Mega with the sketch on it, compiled with these settings."""
    if simulator_missing():
        pytest.skip("no AVR simulator: apt install gcc-avr avr-libc arduino-core-avr make gcc libsimavr-dev")
    program = build_board(folder)

    def board(size: int = 10, baud: int = 512_000) -> Board:
        return Board(program, build(folder, size, size, baud), folder, size, size)

    return board


@pytest.fixture(scope="module", params=[8, 10])
def size(request: pytest.FixtureRequest) -> int:
    """Rows and columns of a pad."""
    return int(request.param)


@pytest.fixture(scope="module")
def run(board: MakeBoard, size: int) -> Run:
    """A run of a pad of that size, with one picture per scan."""
    return board(size).run(pictures_of(size, size), RUN_S)


def test_the_pins_values_arrive_without_a_lost_frame(run: Run, size: int) -> None:
    pictures, parser = pictures_of(size, size), parser_for(size)
    frames = parser.feed(run.sent, 0.0)
    assert len(frames) >= RUN_S * FRAME_RATE_HZ - 3
    assert len(run.began_ms) - len(frames) <= 1
    assert parser.counts.bad == parser.counts.duplicates == 0
    inner = slice(1, 9) if size == 10 else slice(0, 8)
    for frame, picture in zip(frames, pictures, strict=False):
        np.testing.assert_array_equal(frame.pressure, MAX_COUNT - picture[inner, inner])


def test_the_border_taxels_are_sent_in_place(run: Run, size: int) -> None:
    raw = run.raw(size, size)
    np.testing.assert_array_equal(raw, pictures_of(size, size)[: len(raw)])


def test_frames_come_at_54_hz_by_both_clocks(run: Run, size: int) -> None:
    frames = parser_for(size).feed(run.sent, 0.0)
    assert 1000 / steps_ms(frames).mean() == pytest.approx(FRAME_RATE_HZ, rel=0.005)
    assert 1000 / np.diff(run.began_ms).mean() == pytest.approx(FRAME_RATE_HZ, rel=1e-5)
    np.testing.assert_allclose(np.diff(run.began_ms), PERIOD_MS, atol=0.05)


def test_a_scan_is_sent_before_the_next_is_due(run: Run, size: int) -> None:
    assert run.until_sent_ms < 0.7 * PERIOD_MS
    readme = (FIRMWARE / "README.md").read_text()
    said = re.search(rf"\| {size}.{size} \| ([\d.]+) ms \| ([\d.]+) ms \|", readme)
    assert said is not None
    assert float(said[1]) == pytest.approx(run.scan_ms, abs=0.1)
    assert float(said[2]) == pytest.approx(run.until_sent_ms, abs=0.1)


def test_a_row_has_settled_before_it_is_read(run: Run) -> None:
    assert run.least_settling_us >= 50


def test_a_slow_line_skips_scans_and_keeps_the_clock(board: MakeBoard) -> None:
    pictures = pictures_of(10, 10)
    run = board(baud=57_600).run(pictures, RUN_S)
    parser = FabricGrid()
    frames = parser.feed(run.sent, 0.0)
    assert 0.37 * RUN_S * FRAME_RATE_HZ < len(frames) < 0.6 * RUN_S * FRAME_RATE_HZ
    assert parser.counts.bad == 0
    began_ms = run.began_ms[: len(frames)]
    np.testing.assert_allclose([frame.sensor_ms for frame in frames], began_ms, atol=2.0)
    for frame, picture in zip(frames, pictures, strict=False):
        np.testing.assert_array_equal(frame.pressure, MAX_COUNT - picture[1:9, 1:9])


@pytest.mark.skipif(shutil.which("c++") is None, reason="no C++ compiler")
def test_a_teensy_gives_the_same_frames(folder: Path, size: int) -> None:
    program = folder / f"teensy-{size}"
    flags = ["-Wall", "-Wextra", "-Werror", "-DTEENSYDUINO=159", f"-DROWS={size}", f"-DCOLUMNS={size}"]
    subprocess.run(["c++", *flags, f"-I{TEENSY}", TEENSY / "main.cpp", "-o", program], check=True)
    parser = parser_for(size)
    frames = parser.feed(subprocess.run([program, "2"], check=True, capture_output=True).stdout, 0.0)
    assert len(frames) == 2.0 * FRAME_RATE_HZ - 1
    assert parser.counts.bad == 0
    assert 1000 / steps_ms(frames).mean() == pytest.approx(FRAME_RATE_HZ, rel=0.001)
    row, column = np.mgrid[1:9, 1:9] if size == 10 else np.mgrid[0:8, 0:8]
    for scan, frame in enumerate(frames):
        np.testing.assert_array_equal(frame.pressure, MAX_COUNT - (100 * row + 10 * column + scan % 10))


def pins(name: str) -> list[str]:
    found = re.search(rf"{name}\[\] = {{(.*?)}}", SKETCH.read_text())
    assert found is not None
    return found[1].split(", ")


def words_of(picture: str) -> list[str]:
    """Return the text of a picture in drawing order."""
    return re.findall(r">([^<>]+)</text>", (FIRMWARE / picture).read_text())


@pytest.mark.parametrize("picture", ["wiring-mega.svg", "wiring-teensy.svg"])
def test_the_wiring_pictures_show_the_pins_of_the_sketch(picture: str) -> None:
    words = words_of(picture)
    assert "teensy" in picture or "3.3 kΩ from each" in words
    pairs = list(pairwise(words))
    for number, pin in enumerate(pins("ROW_PINS"), 1):
        # Once at the pad, once at the board.
        assert pairs.count((pin, f"row {number}")) == 2
    on_board = "{pin}, column {number}" if "teensy" in picture else "column {number}"
    for number, pin in enumerate(pins("COLUMN_PINS"), 1):
        socket = str(13 + number) if "teensy" in picture else pin
        assert (pin, str(number)) in pairs
        assert (socket, on_board.format(pin=pin, number=number)) in pairs
