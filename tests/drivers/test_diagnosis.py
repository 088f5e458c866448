"""Bytes without frames are diagnosed by their appearance."""

import msgspec
import numpy as np
import pytest
from rigs.formats import encode_csv_line, encode_fabric_grid
from rigs.wire import counts_of

from touchd.drivers.pad.diagnosis import caution, diagnose, propose
from touchd.drivers.pad.format import PRESETS, PadFormat, encode_frame, encode_values


def pad(preset: str, rows: int, columns: int) -> PadFormat:
    return msgspec.structs.replace(PRESETS[preset], rows=rows, columns=columns, crop=(rows - 8) // 2)


RANDOM = np.random.default_rng(0).bytes(4000)


def binary(rows: int, columns: int) -> bytes:
    """Frames of a pad of any size, cut at both ends."""
    raw = np.random.default_rng(1).integers(0, 1024, (rows, columns)).astype(np.uint16)
    sent = pad("fabric-grid", rows, columns)
    return b"".join(encode_values(sent, raw, ms) for ms in range(1000, 1400, 19))[100:-60]


def printed(numbers: int) -> bytes:
    return b"".join(b",".join([b"%d" % (17 * i)] * numbers) + b"\r\n" for i in range(12))


LOG = b"Booting...\r\nwifi connected, rssi -60\r\n" * 60
FOUR_FRAMES = b"".join(encode_fabric_grid(counts_of(i), 19 * i) for i in range(4))
SUMMED = PadFormat(rows=8, columns=8, header="beef", checksum="sum8")
TWO_SUMS = b"".join(encode_frame(SUMMED, counts_of(number) % 7, None) for number in range(12))
DAMAGED = bytes(byte for at, byte in enumerate(binary(10, 10)) if at % 37)


@pytest.mark.parametrize(
    "step_ms", [0, -19, 18_500, 1000, 400_000_000], ids=["still", "backwards", "us", "1 Hz", "random"]
)
@pytest.mark.parametrize("frames", [5, 40])
def test_a_pad_whose_clock_is_wrong_is_no_other_pad(step_ms: int, frames: int) -> None:
    sent = (encode_fabric_grid(counts_of(i), (10**6 + step_ms * i) % 2**32) for i in range(frames))
    data = b"".join(sent)[50:-20]
    assert propose(data) == PRESETS["fabric-grid"]
    assert diagnose(data, PRESETS["fabric-grid"])[0] == "clock"


@pytest.mark.parametrize(
    ("data", "expected", "kind", "words"),
    [
        (binary(8, 8), pad("fabric-grid", 10, 10), "format", "looks like fabric-grid 8x8, configured"),
        (binary(16, 16), pad("fabric-grid", 8, 8), "format", "looks like fabric-grid 16x16, configured"),
        (binary(8, 10), pad("fabric-grid", 8, 8), "format", "looks like fabric-grid 8x10, configured"),
        (binary(10, 10), pad("csv", 10, 10), "format", "looks like fabric-grid 10x10, configured csv 10x10"),
        (binary(10, 10), pad("fabric-grid", 10, 10), "clock", "their clock stands still or jumps"),
        (printed(65), pad("fabric-grid", 8, 8), "format", "looks like csv 8x8, configured fabric-grid 8x8"),
        (encode_csv_line(counts_of(0), 7) * 9, pad("csv", 10, 10), "clock", "their clock stands still"),
        (RANDOM, pad("fabric-grid", 10, 10), "noise", "noise, wrong baud rate?"),
        (b"\x00" * 3000, pad("fabric-grid", 10, 10), "noise", "noise"),
        (b"\xff" * 3000, pad("fabric-grid", 10, 10), "noise", "noise"),
        (b"x", pad("csv", 10, 10), "noise", "noise"),
        (FOUR_FRAMES, pad("fabric-grid", 8, 8), "format", "looks like fabric-grid 10x10"),
        (
            LOG,
            pad("fabric-grid", 10, 10),
            "text",
            "such as 'wifi connected, rssi -60', and no frame of fabric",
        ),
        (DAMAGED, pad("fabric-grid", 10, 10), "damage", "none of fabric-grid 10x10"),
    ],
)
def test_a_diagnosis_names_found_and_configured_format(
    data: bytes, expected: PadFormat, kind: str, words: str
) -> None:
    said, reason = diagnose(data, expected)
    assert said == kind
    assert words in reason


@pytest.mark.parametrize(
    ("data", "words"),
    [
        (printed(72), "72 cells came: how many rows and columns"),
        (printed(64), "full_scale"),
        (TWO_SUMS, "checksum may be values or sum8"),
    ],
    ids=["rows", "full scale", "checksums that agree at rest"],
)
def test_what_is_guessed_in_a_proposal_is_said(data: bytes, words: str) -> None:
    proposed = propose(data)
    assert proposed is not None
    assert words in caution(proposed)


@pytest.mark.parametrize("side", [8, 16])
def test_zeros_are_no_checksum(side: int) -> None:
    own = PadFormat(header="aa55", rows=side, columns=side, cell="u8", full_scale=255)
    assert propose(encode_values(own, np.zeros((side, side), np.uint16), None) * 40) == own


def test_a_presets_line_is_known_also_from_a_pad_at_rest() -> None:
    format = PRESETS["m1616"]
    rest = np.zeros((8, 8), np.uint16) + 3
    proposed = propose(b"".join(encode_frame(format, rest + number % 2, 19 * number) for number in range(12)))
    assert proposed == format
