"""Reads the recordings that the detector learns from, without those of held-out people."""

import csv
from collections.abc import Collection
from itertools import groupby
from pathlib import Path

import numpy as np

from touchd.drivers.pad.format import Layout
from touchd.drivers.recording import Recording, on_grid
from touchd.model.training import third_study
from touchd.model.training.detector.pieces import Composer, SetUp, Streamed, set_ups
from touchd.model.training.detector.train import DetectorSettings
from touchd.model.training.haart import open_table, without
from touchd.model.training.studies import Folders

STREAMS = "streams.csv"


def composer(folders: Folders, settings: DetectorSettings) -> Composer:
    """Return the composer of pieces for everybody whom the settings do not hold out."""
    by_study: list[list[SetUp]] = []
    for study in ("haart", "second", "third"):
        if study != settings.left_out_study:
            own = without(folders.to_train_on((study,)), settings.left_out)
            by_study.append(set_ups(own))
    streams: list[Streamed] = []
    if settings.left_out_study != "third":
        streams = uncut(folders.third_study, settings.left_out)
    return Composer(by_study, streams, settings.seed)


def uncut(folder: Path, left_out: Collection[str]) -> list[Streamed]:
    """Return the third study's uncut recordings on the 54 Hz grid, without those of held-out people."""
    layout = Layout(third_study.PAD)
    found = []
    with open_table(folder, STREAMS, "name its folder: --third-study") as file:
        for (_, participant), group in groupby(
            csv.DictReader(file), lambda row: (row["stream"], row["participant"])
        ):
            rows = list(group)
            if participant in left_out:
                continue
            cells = [[int(row[f"c{i}"]) for i in range(1, third_study.PAD.cells + 1)] for row in rows]
            values = np.clip(np.array(cells), 0, None).astype(np.uint16)
            sensor_ms = np.array([round(float(row["ms"])) for row in rows], dtype=np.int64)
            counts = np.stack([layout.pressure(scan) for scan in values])
            laid = on_grid(Recording(participant, "", "none", "", counts, sensor_ms, "live"))
            labelled_ms = [ms for ms, row in zip(sensor_ms, rows, strict=True) if row["label"]]
            at_ms = np.asarray(laid.sensor_ms)
            first, last = (labelled_ms[0], labelled_ms[-1]) if labelled_ms else (np.inf, -np.inf)
            is_touch = rows[0]["gesture"] != "notouch"
            touched = (at_ms >= first) & (at_ms <= last) & is_touch
            found.append(Streamed(np.asarray(laid.counts, np.float32), touched))
    return found
