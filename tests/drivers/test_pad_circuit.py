"""The firmware's page: its wiring and figures match the sketch and the simulated circuit."""

import re
from itertools import pairwise

import numpy as np
import pytest
from numpy.typing import NDArray
from rigs.mega_rig import FIRMWARE, SKETCH
from rigs.pad_circuit import (
    PULL_UP_OHM,
    REST_OHM,
    ROW_RESISTOR_OHM,
    column_volts,
    pad,
    pressure,
    row_milliamperes,
)

PAGE = " ".join((FIRMWARE / "README.md").read_text().split())
CORNERS = pad((2, 2), (2, 6), (6, 2))


def counts(taxels_ohm: NDArray[np.float64], *, others_high: bool = True) -> NDArray[np.int64]:
    return np.rint(pressure(column_volts(taxels_ohm, others_high=others_high))).astype(np.int64)


def said(pattern: str) -> list[float]:
    """Return the figures in the page's text that match a pattern."""
    found = re.search(pattern, PAGE)
    assert found is not None, pattern
    return [float(figure) for figure in found.groups()]


def test_an_untouched_corner_of_a_rectangle_stays_untouched() -> None:
    touched = counts(CORNERS)[[2, 2, 6], [2, 6, 2]]
    assert touched.min() > 300
    figures = said(r"would read (\d+) counts; driven it reads (\d+), at a rest of (\d+)")
    assert figures == [counts(CORNERS, others_high=False)[6, 6], counts(CORNERS)[6, 6], counts(pad())[6, 6]]


def test_two_presses_reduce_each_other_as_documented() -> None:
    alone, column = counts(pad((2, 2)))[2, 2], counts(pad((2, 2), (6, 2)))[2, 2]
    row = counts(pad((2, 2), (2, 6)))[2, 2]
    assert said(r"(\d+) counts become (\d+) \(two in one row: (\d+)\)") == [alone, column, row]


def test_a_press_reads_the_documented_counts() -> None:
    pressed_ohm = [30_000.0, 10_000.0, 3_000.0, 1_000.0, 300.0]
    figures = said(r"\| counts \| (\d+) \| (\d+) \| (\d+) \| (\d+) \| (\d+) \|")
    assert figures == [counts(pad((3, 4), ohm=ohm))[3, 4] for ohm in pressed_ohm]


def test_a_weak_pull_up_gives_a_rest_of_ten() -> None:
    assert pytest.approx(REST_OHM / 100) == PULL_UP_OHM
    assert counts(pad()).mean() == pytest.approx(10, abs=2)


def test_a_column_without_pull_up_shows_in_its_rest() -> None:
    (rest,) = said(r"a column that rests at some (\d+) counts")
    unpulled = pressure(column_volts(pad(), pull_up_ohm=1e12))
    np.testing.assert_allclose(unpulled, rest, atol=5)


def test_no_pin_is_overloaded_however_hard_the_press() -> None:
    (milliamperes,) = said(r"draws (\d+) mA through a row's pin")
    assert round(row_milliamperes(np.full((10, 10), 1_000.0))) == milliamperes
    assert row_milliamperes(np.full((10, 10), 1.0)) < 40


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
    pairs = list(pairwise(words))
    for number, pin in enumerate(pins("ROW_PINS"), 1):
        # Once at the pad, once at the board.
        assert pairs.count((pin, f"row {number}")) == 2
    on_board = "{pin}, column {number}" if "teensy" in picture else "column {number}"
    for number, pin in enumerate(pins("COLUMN_PINS"), 1):
        socket = str(13 + number) if "teensy" in picture else pin
        assert (pin, str(number)) in pairs
        assert (socket, on_board.format(pin=pin, number=number)) in pairs


def test_the_mega_picture_shows_the_solved_resistors() -> None:
    words = words_of("wiring-mega.svg")
    assert f"{ROW_RESISTOR_OHM:g} Ω" in words
    assert f"{PULL_UP_OHM / 1000:g} kΩ from each" in words
