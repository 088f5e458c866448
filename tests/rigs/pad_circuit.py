"""A pad as a network of resistors on a board's pins: what its columns read, row by row."""

import numpy as np
from numpy.typing import NDArray

from touchd.drivers.frame import MAX_COUNT

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
    driven high; otherwise they are left open.
    """
    return _strip_volts(taxels_ohm, others_high, pull_up_ohm)[:, len(taxels_ohm) :]


def row_milliamperes(taxels_ohm: NDArray[np.float64]) -> float:
    """Return the largest current into a row's pin while it is low and all others are high."""
    return float(_strip_volts(taxels_ohm, True, PULL_UP_OHM).diagonal().max()) / ROW_OHM * 1000


def pressure(volts: NDArray[np.float64]) -> NDArray[np.float64]:
    """Convert column voltages to counts of pressure, as touchd receives them."""
    return MAX_COUNT - volts / SUPPLY_V * MAX_COUNT


def _strip_volts(
    taxels_ohm: NDArray[np.float64], others_high: bool, pull_up_ohm: float
) -> NDArray[np.float64]:
    """Return the voltage of each strip, rows then columns, while each row is low, (rows, rows + columns).

    Solved by Kirchhoff's current law at every strip.
    """
    taxels = 1 / taxels_ohm
    rows, columns = taxels.shape
    volts = np.empty((rows, rows + columns))
    for low in range(rows):
        # Conductances between strips, and currents into them.
        conductance = np.zeros((rows + columns, rows + columns))
        conductance[:rows, rows:] = -taxels
        conductance[rows:, :rows] = -taxels.T
        own = np.concatenate([taxels.sum(axis=1), taxels.sum(axis=0) + 1 / pull_up_ohm])
        current = np.concatenate([np.zeros(rows), np.full(columns, SUPPLY_V / pull_up_ohm)])
        for row in range(rows):
            if row == low or others_high:
                own[row] += 1 / ROW_OHM
                current[row] = 0.0 if row == low else SUPPLY_V / ROW_OHM
        np.fill_diagonal(conductance, own)
        volts[low] = np.linalg.solve(conductance, current)
    return volts
