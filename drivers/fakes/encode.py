"""Encodes pressure as a pad would send it: the inverse of the parsers, for fake pads and tests."""

import numpy as np

from touchd.drivers.frame import MAX_COUNT, Counts
from touchd.drivers.pad.binary import CLOCK_BYTES, PLAIN_CELLS, U12_BITS, checksum
from touchd.drivers.pad.clock import UNITS_MS
from touchd.drivers.pad.format import PadFormat, Values


def encode_frame(described: PadFormat, counts: Counts, sensor_ms: int | None) -> bytes:
    """Return pressure (8, 8) as the pad would send it; sensor_ms: None leaves the clock at 0."""
    return encode_values(described, values_of(described, counts), sensor_ms)


def encode_values(described: PadFormat, values: Values, sensor_ms: int | None) -> bytes:
    """Return values (rows, columns) as the pad would send them.

    Text is one line, or a line for each row if the format has an `end`. The first skipped number is the clock
    or the row's number.
    """
    time = round((sensor_ms or 0) / (UNITS_MS[described.clock] or 1)) % 2**32
    if described.framing == "text":
        lines = values.reshape(-1, described.columns if described.end else described.cells).tolist()
        firsts = range(len(lines)) if described.end else [time]
        rest = [0] * (described.skip - 1)
        after = [0] * described.tail
        text = [
            ",".join(f"{number:.10g}" for number in (*[first, *rest][: described.skip], *line, *after))
            for first, line in zip(firsts, lines, strict=True)
        ]
        return "\n".join([*text, *([described.end] if described.end else []), ""]).encode()
    body = time.to_bytes(CLOCK_BYTES, described.order) if described.has_clock else b""
    body += bytes(described.skip) + _cells(described, values.ravel()) + bytes(described.tail)
    if described.checksum != "none":
        body += bytes([checksum(described, body, int(values.sum()) + time * described.has_clock)])
    return described.header_bytes + body


def values_of(described: PadFormat, counts: Counts) -> Values:
    """Turn pressure (8, 8) into values (rows, columns) that decode to it; cropped cells are at rest."""
    turned = np.rot90(counts[:, ::-1] if described.mirror else counts, described.turn // 90)
    rows, columns, crop = described.rows, described.columns, described.crop
    down, right = (np.arange(side) * 8 // side for side in described.used)
    grid = np.zeros((rows, columns), turned.dtype)
    grid[crop : rows - crop, crop : columns - crop] = turned[down[:, None], right]
    if described.invert:
        grid = MAX_COUNT - grid
    values = grid * (described.full_scale / MAX_COUNT)
    return values if described.cell == "f32" else np.rint(values).astype(np.uint16)


def _cells(described: PadFormat, values: Values) -> bytes:
    """Return values (cells,) as a binary frame contains them."""
    if described.cell != "u12":
        return values.astype(PLAIN_CELLS[described.cell, described.order]).tobytes()
    bits = values.astype(np.uint16)[:, None] >> U12_BITS[described.order] & 1
    return np.packbits(bits.astype(np.uint8), bitorder=described.order).tobytes()
