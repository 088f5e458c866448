"""The firmware's page: its wiring and figures match the sketch and the simulated circuit."""

import re
from itertools import pairwise

import numpy as np
import pytest
from numpy.typing import NDArray
from rigs.mega_rig import FIRMWARE, SKETCH
from rigs.pad_circuit import (
    PULL_UP_OHM,
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


@pytest.mark.parametrize(
    ("said", "figures"),
    [
        (
            r"would read (\d+) counts; driven it reads (\d+), at a rest of (\d+)",
            [counts(CORNERS, others_high=False)[6, 6], counts(CORNERS)[6, 6], counts(pad())[6, 6]],
        ),
        (
            r"(\d+) counts become (\d+) \(two in one row: (\d+)\)",
            [counts(pad((2, 2), *other))[2, 2] for other in ((), ((6, 2),), ((2, 6),))],
        ),
        (
            r"\| counts \| (\d+) \| (\d+) \| (\d+) \| (\d+) \| (\d+) \|",
            [counts(pad((3, 4), ohm=ohm))[3, 4] for ohm in (30_000.0, 10_000.0, 3_000.0, 1_000.0, 300.0)],
        ),
        (
            r"draws (\d+) mA through a row's pin",
            [round(row_milliamperes(np.full((10, 10), 1_000.0)))],
        ),
    ],
)
def test_the_page_has_the_circuits_figures(said: str, figures: list[float]) -> None:
    found = re.search(said, PAGE)
    assert found is not None, said
    assert list(map(float, found.groups())) == figures


def test_no_pin_is_overloaded_however_hard_the_press() -> None:
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
