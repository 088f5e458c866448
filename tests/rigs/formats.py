"""Parsers and encoders of the lab's pads."""

import msgspec

from drivers.frame import Counts
from drivers.pad.binary import BinaryFrames
from drivers.pad.format import PRESETS, PadFormat, encode_frame
from drivers.pad.text import TextFrames


def _described(preset: str, rows: int, columns: int, crop: int, invert: bool) -> PadFormat:
    return msgspec.structs.replace(PRESETS[preset], rows=rows, columns=columns, crop=crop, invert=invert)


class FabricGrid(BinaryFrames):
    def __init__(self, rows: int = 10, columns: int = 10, crop: int = 1, invert: bool = True) -> None:
        super().__init__(_described("fabric-grid", rows, columns, crop, invert))


class CsvLines(TextFrames):
    def __init__(self, rows: int = 10, columns: int = 10, crop: int = 1, invert: bool = True) -> None:
        super().__init__(_described("csv", rows, columns, crop, invert))


def encode_fabric_grid(
    counts: Counts, sensor_ms: int, rows: int = 10, columns: int = 10, crop: int = 1, invert: bool = True
) -> bytes:
    return encode_frame(_described("fabric-grid", rows, columns, crop, invert), counts, sensor_ms)


def encode_csv_line(
    counts: Counts,
    sensor_ms: int | None,
    rows: int = 10,
    columns: int = 10,
    crop: int = 1,
    invert: bool = True,
) -> bytes:
    return encode_frame(_described("csv", rows, columns, crop, invert), counts, sensor_ms)
