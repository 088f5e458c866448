"""A pad as a network of resistors on a board's pins: what its columns read, row by row."""

import numpy as np
from numpy.typing import NDArray

from drivers.frame import MAX_COUNT

SUPPLY_V = 5.0
PULL_UP_OHM = 3300.0
# The resistor in each row's wire, and the pin of an ATmega2560 behind it.
ROW_RESISTOR_OHM = 100.0
ROW_OHM = ROW_RESISTOR_OHM + 25.0
REST_OHM = 330_000.0


def pad(*pressed: tuple[int, int], ohm: float = 3_000.0) -> NDArray[np.float64]:
    """Return the crossings (10, 10), in ohms, of a pad pressed at some of them."""
    taxels_ohm = np.full((10, 10), REST_OHM)
    for place in pressed:
        taxels_ohm[place] = ohm
    return taxels_ohm


def column_volts(
    taxels_ohm: NDArray[np.float64], *, others_high: bool = True, pull_up_ohm: float = PULL_UP_OHM
) -> NDArray[np.float64]:
    """Return each column pin's settled voltage while each row is low, (rows, columns).

    taxels_ohm: (rows, columns), the fabric at each crossing. others_high: the rows that are not read are
    driven high; otherwise they are left open. Solved by Kirchhoff's current law at every strip.
    """
    rows, columns = taxels_ohm.shape
    volts = np.empty((rows, columns))
    for low in range(rows):
        conductance, current = _strips(1 / taxels_ohm, pull_up_ohm)
        for row in range(rows):
            if row == low or others_high:
                conductance[row, row] += 1 / ROW_OHM
                current[row] = 0.0 if row == low else SUPPLY_V / ROW_OHM
        volts[low] = np.linalg.solve(conductance, current)[rows:]
    return volts


def row_milliamperes(taxels_ohm: NDArray[np.float64]) -> float:
    """Return the largest current into a row's pin while it is low and all others are high."""
    rows, _ = taxels_ohm.shape
    largest = 0.0
    for low in range(rows):
        conductance, current = _strips(1 / taxels_ohm, PULL_UP_OHM)
        conductance[range(rows), range(rows)] += 1 / ROW_OHM
        current[:rows] = SUPPLY_V / ROW_OHM
        current[low] = 0.0
        largest = max(largest, np.linalg.solve(conductance, current)[low] / ROW_OHM * 1000)
    return largest


def pressure(volts: NDArray[np.float64]) -> NDArray[np.float64]:
    """Convert column voltages to counts of pressure, as touchd receives them."""
    return MAX_COUNT - volts / SUPPLY_V * MAX_COUNT


def _strips(
    taxels: NDArray[np.float64], pull_up_ohm: float
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """The pad and its pull-ups: conductances between strips, rows then columns, and currents into them."""
    rows, columns = taxels.shape
    conductance = np.zeros((rows + columns, rows + columns))
    conductance[:rows, rows:] = -taxels
    conductance[rows:, :rows] = -taxels.T
    conductance[range(rows), range(rows)] = taxels.sum(axis=1)
    across = range(rows, rows + columns)
    conductance[across, across] = taxels.sum(axis=0) + 1 / pull_up_ohm
    current = np.zeros(rows + columns)
    current[rows:] = SUPPLY_V / pull_up_ohm
    return conductance, current
