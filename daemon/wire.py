"""What is on the configured pad's line: the parser for it, and the encoder for a port that plays it."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

from daemon.config import SensorSettings
from drivers.frame import Counts
from drivers.pad.protocol import CsvLines, FabricGrid, Protocol, encode_csv_line, encode_fabric_grid


def description_of(sensor: SensorSettings) -> str:
    """Return in a line which pad it is and how it is read, for those who use its recordings later."""
    return (
        f"{parser_for(sensor).description}, crop {sensor.crop}, invert {sensor.invert}, "
        f"at {sensor.baud} baud on {sensor.port}"
    )


def parser_for(sensor: SensorSettings) -> Protocol:
    """Return a parser for what the pad sends."""
    kind = FabricGrid if sensor.protocol == "fabric-grid" else CsvLines
    return kind(rows=sensor.rows, columns=sensor.columns, crop=sensor.crop, invert=sensor.invert)


def encoder_for(sensor: SensorSettings) -> Callable[[Counts, int], bytes]:
    """Return what turns counts (8, 8) and the sensor's clock in ms into the bytes that the pad would send."""
    encode = encode_fabric_grid if sensor.protocol == "fabric-grid" else encode_csv_line
    return partial(encode, rows=sensor.rows, columns=sensor.columns, crop=sensor.crop, invert=sensor.invert)
