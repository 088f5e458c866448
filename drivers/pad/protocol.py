"""The protocols a pad may speak, behind one interface: bytes in, frames out, no I/O."""

from __future__ import annotations

import typing

from drivers.frame import Frame
from drivers.pad.csv_lines import CsvLines, encode_csv_line
from drivers.pad.fabric_grid import FabricGrid, encode_fabric_grid
from drivers.pad.framing import ProtocolCounts, ProtocolError

__all__ = [
    "CsvLines",
    "FabricGrid",
    "Protocol",
    "ProtocolCounts",
    "ProtocolError",
    "encode_csv_line",
    "encode_fabric_grid",
]


class Protocol(typing.Protocol):
    """A parser: drops and counts what is damaged, never raises on it, keeps a bounded number of bytes."""

    counts: ProtocolCounts

    @property
    def description(self) -> str:
        """What the parser expects, in words for a person, as in "fabric-grid 10x10"."""

    def feed(self, data: bytes, host_s: float) -> list[Frame]:
        """Take bytes that arrived at `host_s` (monotonic seconds); return the frames they completed."""

    def reset(self) -> None:
        """Forget half a frame and the clock after a reconnect; counts and frame numbers go on."""
