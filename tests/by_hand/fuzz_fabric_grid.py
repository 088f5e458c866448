"""Coverage-guided fuzzing of the parser, by hand: `pip install atheris`, then

PYTHONPATH=. python tests/fuzz_fabric_grid.py -max_total_time=600

Whatever comes in, the parser does not raise, keeps less than two frames' bytes, accounts for each byte, and
delivers the same however the bytes are cut.
"""

from __future__ import annotations

import sys

import atheris

with atheris.instrument_imports(include=["drivers"]):
    from rigs.formats import FabricGrid

SIZE = 4 + 4 + 2 * 64 + 1


def one_input(data: bytes) -> None:
    """Feed `data` whole and in pieces whose lengths are its own first bytes."""
    whole, cut = FabricGrid(8, 8, 0), FabricGrid(8, 8, 0)
    at_once = [(frame.sensor_ms, frame.pressure.tobytes()) for frame in whole.feed(data, 0.0)]
    pieces = []
    position = 0
    for length in [*data[:64], len(data)]:
        frames = cut.feed(data[position : position + length], 0.0)
        pieces += [(frame.sensor_ms, frame.pressure.tobytes()) for frame in frames]
        position += length
        assert cut.pending_bytes < 2 * SIZE
    assert pieces == at_once
    assert cut.counts == whole.counts
    assert whole.counts.bytes_dropped + whole.pending_bytes + SIZE * len(at_once) <= len(data)


if __name__ == "__main__":
    atheris.Setup(sys.argv, one_input)
    atheris.Fuzz()
