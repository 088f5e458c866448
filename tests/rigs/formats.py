"""Parsers and encoders of the lab's pads."""

from typing import Any

import msgspec

from touchd.drivers.fakes.encode import encode_frame
from touchd.drivers.frame import Counts
from touchd.drivers.pad.format import PRESETS, PadFormat
from touchd.drivers.pad.parser import FrameParser


def _fabric_grid(changes: dict[str, Any]) -> PadFormat:
    return msgspec.structs.replace(PRESETS["fabric-grid"], **changes)


class FabricGrid(FrameParser):
    def __init__(self, **changes: Any) -> None:
        super().__init__(_fabric_grid(changes))


class CsvLines(FrameParser):
    def __init__(self) -> None:
        super().__init__(PRESETS["csv"])


def encode_fabric_grid(counts: Counts, sensor_ms: int, **changes: Any) -> bytes:
    return encode_frame(_fabric_grid(changes), counts, sensor_ms)


def encode_csv_line(counts: Counts, sensor_ms: int | None) -> bytes:
    return encode_frame(PRESETS["csv"], counts, sensor_ms)
