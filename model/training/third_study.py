"""The third study as training and test data: another kind of pad, 6x6, capacitive, soft.

Source: ShearSense recordings of the UBC SPIN lab (pressure channel), the sensor of "What is Affective Touch
Made Of?" (UIST 2024). Scans are laid on 8x8 taxels and on the 54 Hz grid by the stream's own code.
"""

import csv
from collections.abc import Collection
from itertools import groupby
from pathlib import Path

import numpy as np

from touchd.drivers.pad.format import Layout, PadFormat
from touchd.drivers.recording import Recording, on_grid
from touchd.model.training.haart import open_table

FILE = "recordings.csv"
PAD = PadFormat(framing="text", rows=6, columns=6)
OTHERS = ("fist", "karate", "knead", "massage", "pinch", "poke", "twist", "type")
"""Its gestures that are none of touchd's. Press, tap, drag and slide are too near to them to be either."""
KEYS = ("recording", "participant", "substrate", "gesture", "seven")


def read(folder: Path, others: Collection[str] = ()) -> list[Recording]:
    """Read the recordings of gestures that touchd has a name for, in file order, on the 54 Hz grid.

    others: further gestures to read, by the study's own names. Raises RecordingError without the file.
    """
    with open_table(folder, FILE, "name its folder: --third-study") as file:
        header, *rows = csv.reader(file)
    first_cell = header.index("c1")
    at = [header.index(key) for key in KEYS]
    clock = header.index("ms")
    layout = Layout(PAD)
    recordings = []
    for (_, participant, substrate, own, seven), group in groupby(
        rows, lambda row: tuple(row[i] for i in at)
    ):
        gesture = seven or own
        if not seven and own not in others:
            continue
        scans = list(group)
        values = np.array([row[first_cell:] for row in scans], dtype=np.float64).astype(np.uint16)
        counts = np.stack([layout.pressure(scan) for scan in values])
        sensor_ms = np.array([round(float(row[clock])) for row in scans], dtype=np.int64)
        recordings.append(
            on_grid(Recording(participant, substrate, "none", gesture, counts, sensor_ms, "live"))
        )
    return recordings
