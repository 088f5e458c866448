"""A hand that presses a pad of any size, for tests that search its bytes."""

from collections.abc import Sequence

import numpy as np
from numpy.random import Generator
from numpy.typing import NDArray

from touchd.drivers.fakes.encode import encode_values
from touchd.drivers.pad.format import Layout, PadFormat
from touchd.drivers.pad.parser import FrameParser
from touchd.drivers.search.listen import Chunk

SECONDS = 8.0


def pressed(
    rows: int, columns: int, full_scale: float, rng: Generator, rate_hz: float = 50.0
) -> NDArray[np.float64]:
    """Return (frames, rows, columns) of a pad at rest for a while, then under a hand that wanders."""
    time_s = np.arange(round(SECONDS * rate_hz)) / rate_hz
    y, x = np.mgrid[0:rows, 0:columns]
    noise = full_scale / 1023 if full_scale <= 10 else max(full_scale / 1023, 1)
    begins_s, turns, phase = rng.uniform(0.5, 2.0), rng.uniform(0.6, 1.6), rng.uniform(0, 6)
    frames = rng.integers(2, 5, (len(time_s), rows, columns)).astype(float) * noise
    frames = np.minimum(frames, full_scale)
    for number, at_s in enumerate(time_s):
        if at_s > begins_s:
            down = (rows - 1) * (0.5 + 0.5 * np.sin(2 * turns * at_s + phase))
            right = (columns - 1) * (0.5 + 0.5 * np.cos(1.3 * turns * at_s))
            force = full_scale * (0.35 + 0.25 * np.sin(3 * at_s))
            size = np.maximum((rows / 5, columns / 5), 0.8)
            frames[number] += force * np.exp(-(((y - down) / size[0]) ** 2) - ((x - right) / size[1]) ** 2)
    return np.clip(frames, 0, full_scale)


def chunks_of(described: PadFormat, seed: int = 0, rate_hz: float = 50.0) -> list[Chunk]:
    """Return what such a pad sends, a frame at a time, from the middle of a frame on."""
    rng = np.random.default_rng(seed)
    values = pressed(described.rows, described.columns, described.full_scale, rng, rate_hz)
    if described.invert:
        values = described.full_scale - values
    if described.cell != "f32":
        values = np.floor(values)
    sent = [
        Chunk(encode_values(described, frame, 5000 + round(1000 * number / rate_hz)), number / rate_hz)
        for number, frame in enumerate(values)
    ]
    sent[0] = sent[0]._replace(data=sent[0].data[len(sent[0].data) // 3 :])
    return sent


def likeness(found: PadFormat, chunks: Sequence[Chunk], values: NDArray[np.generic]) -> float:
    """Return how well what a format reads of chunks resembles the values (T, rows, columns) in them, up to 1.

    A frame may be read with the one it is in, or with the next.
    """
    parser, (rows, columns) = FrameParser(found), values.shape[1:]
    layout = Layout(PadFormat(framing="text", rows=rows, columns=columns, full_scale=float(values.max())))
    read = [
        (number, frame.pressure)
        for number, chunk in enumerate(chunks)
        for frame in parser.feed(*chunk)
        if number
    ]
    assert len(read) > 150

    def alike(late: int) -> float:
        one = np.array([pressure for _, pressure in read], float)
        other = np.array([layout.pressure(values[number - late].ravel()) for number, _ in read], float)
        return float(np.corrcoef((one - one[0]).ravel(), (other - other[0]).ravel())[0, 1])

    return max(alike(0), alike(1))
