"""A pad is proposed only from bytes that prove it; anything else is refused in words."""

import resource
import time
from typing import Literal

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from msgspec.structs import replace
from rigs.coarse_pad import JUDGED_ON, printed, third_study
from rigs.haart_folder import needs_third_study
from rigs.pressing import chunks_of, likeness, pressed

from touchd.drivers.fakes.encode import encode_values
from touchd.drivers.pad.format import PRESETS, PadFormat
from touchd.drivers.search.listen import Chunk, likelihood
from touchd.drivers.search.search import Finding, as_yaml, search

SIDES = st.integers(4, 32)


def found_in(described: PadFormat, seed: int = 0) -> Finding:
    """Search what a pressed pad sends, told its grid."""
    return search(chunks_of(described, seed), (described.rows, described.columns))


RNG = np.random.default_rng(0)


@st.composite
def binary_formats(draw: st.DrawFn) -> PadFormat:
    cell = draw(st.sampled_from(["u8", "u16", "i16", "f32"]))
    checksum = "none" if cell == "f32" else draw(st.sampled_from(["none", "values", "sum8", "xor8"]))
    return PadFormat(
        rows=draw(SIDES),
        columns=draw(SIDES),
        cell=cell,
        order="little" if cell == "u8" else draw(st.sampled_from(["little", "big"])),
        header=draw(st.binary(min_size=1, max_size=4)).hex(),
        skip=draw(st.integers(0, 3)),
        tail=draw(st.integers(0, 2)) if checksum == "none" else 0,
        checksum=checksum,
        full_scale=draw(
            st.sampled_from(
                {"u8": [120, 255], "u12": [4095], "u16": [250, 1023], "i16": [4095], "f32": [1, 1023]}[cell]
            )
        ),
        invert=draw(st.booleans()),
    )


text_formats = st.builds(
    PadFormat,
    framing=st.just("text"),
    rows=SIDES,
    columns=SIDES,
    skip=st.integers(0, 2),
    end=st.sampled_from(["", "END", "]"]),
    full_scale=st.sampled_from([255, 1023, 4095]),
    invert=st.booleans(),
)
any_format = st.one_of(binary_formats(), text_formats)


NOISY = PadFormat(header="0155", cell="u8", full_scale=120, checksum="values")
PLAIN = PadFormat(framing="text", full_scale=255)


@pytest.mark.parametrize(
    ("described", "rows", "columns", "told", "seed"),
    [
        (NOISY, 4, 6, (6, 4), 0),
        (NOISY, 16, 10, (10, 16), 0),
        (PLAIN, 4, 20, (4, 20), 1),
        (PLAIN, 4, 6, (4, 6), 2),
    ],
)
def test_sides_are_swapped_only_if_they_were_given_wrongly(
    described: PadFormat, rows: int, columns: int, told: tuple[int, int], seed: int
) -> None:
    found = search(chunks_of(replace(described, rows=rows, columns=columns), seed), told).proposed
    assert found is not None
    assert (found.rows, found.columns) == (rows, columns)


def test_a_checksum_that_holds_shows_where_the_cells_are() -> None:
    # One byte off, so few cells move together as well.
    described = PadFormat(header="01", rows=4, columns=4, cell="u8", checksum="values", full_scale=120)
    check_found_or_refused(described, seed=0)


@pytest.mark.slow
@pytest.mark.timeout(900)
@given(described=any_format, seed=st.integers(0, 10**6))
@settings(deadline=None, max_examples=400)
def test_any_pad_that_is_pressed_is_found_or_called_ambiguous(described: PadFormat, seed: int) -> None:
    check_found_or_refused(described, seed)


def check_found_or_refused(described: PadFormat, seed: int) -> None:
    finding = found_in(described, seed)
    if finding.proposed is None:
        assert finding.missing
        return
    found = finding.proposed
    assert (found.rows, found.columns, found.invert) == (described.rows, described.columns, described.invert)
    values = pressed(described.rows, described.columns, described.full_scale, np.random.default_rng(seed))
    assert likeness(found, chunks_of(described, seed), values) > 0.97


EVERY = [
    *PRESETS.values(),
    PadFormat(framing="text", rows=11, columns=4, skip=2, end="END"),
    PadFormat(header="ff", cell="u8", rows=8, columns=8, full_scale=250),
    PadFormat(header="aa55", rows=16, columns=16, tail=2),
    PadFormat(header="aa55aa55", cell="f32", rows=8, columns=8),
]


@pytest.mark.parametrize("described", EVERY, ids=map(str, EVERY))
def test_a_pad_is_found_only_if_somebody_presses_it(described: PadFormat) -> None:
    chunks, grid = chunks_of(described, seed=4), (described.rows, described.columns)
    finding = search(chunks, grid)
    assert finding.proposed is not None, finding.missing
    assert (finding.proposed.rows, finding.proposed.columns) == grid
    assert finding.proposed.invert == described.invert
    assert "\n" not in as_yaml(finding.proposed)
    still = search([chunk for chunk in chunks if chunk.host_s < 0.4] * 4, grid)
    assert still.proposed is None
    assert "press" in still.missing or "frames" in still.missing


def test_the_labs_pad_is_found_with_clock_checksum_and_border() -> None:
    fabric = PRESETS["fabric-grid"]
    assert found_in(fabric, 1).proposed == fabric
    # Its header shows its grid, too.
    assert search(chunks_of(fabric, seed=1), None).proposed == fabric


def test_a_presets_line_with_opposite_values_is_not_the_preset() -> None:
    found = found_in(replace(PRESETS["csv"], invert=False), 4).proposed
    assert found is not None
    assert (found.rows, found.columns, found.invert) == (10, 10, False)


IN_BYTES = PadFormat(header="ff55", clock="ms", cell="u8", rows=6, columns=5, full_scale=255)
IN_TEXT = PadFormat(framing="text", rows=6, columns=5, skip=1, clock="ms", full_scale=1023)


@pytest.mark.parametrize(
    ("described", "step", "pace", "unit"),
    [
        (IN_BYTES, 20, 1.0, "ms"),
        (IN_BYTES, 20_000, 1.0, "us"),
        (IN_TEXT, 20, 1.0, "ms"),
        (IN_TEXT, 20_000, 1.0, "us"),
        (IN_TEXT, 20, 1.15, "ms"),
        (IN_TEXT, 20, 1.3, "none"),
        (IN_TEXT, 1, 1.0, "none"),
        (IN_TEXT, 0, 1.0, "none"),
        (IN_TEXT, 10, 1.0, "none"),
    ],
    ids=["bytes", "us in bytes", "text", "us", "fast", "too fast", "frame number", "stands still", "half"],
)
def test_a_clock_is_proven_by_the_frames_arrival(
    described: PadFormat, step: int, pace: float, unit: str
) -> None:
    values = np.floor(pressed(6, 5, described.full_scale, np.random.default_rng(4)))
    chunks = [
        Chunk(encode_values(described, frame, 70_000 + step * number), number * pace / 50)
        for number, frame in enumerate(values)
    ]
    proposed = search(chunks, (6, 5)).proposed
    assert proposed is not None
    assert proposed.clock == unit


@pytest.mark.parametrize("kind", ["none", "values", "sum8", "xor8"])
def test_a_last_byte_that_checks_the_frame_is_found(kind: Literal["none", "values", "sum8", "xor8"]) -> None:
    tail = int(kind == "none")
    found = found_in(PadFormat(header="aa55", rows=8, columns=8, checksum=kind, tail=tail)).proposed
    assert found is not None
    assert (found.checksum, found.tail) == (kind, tail)


@pytest.mark.parametrize(("top", "scale"), [(900, 1023), (3000, 4095), (30_000, 65535)])
def test_values_that_only_grow_under_a_hand_set_the_range(top: int, scale: int) -> None:
    found = found_in(PadFormat(framing="text", rows=8, columns=8, full_scale=top)).proposed
    assert found is not None
    assert found.full_scale == scale


def test_a_megabyte_is_searched_in_bounded_time_and_memory() -> None:
    fine = PadFormat(header="aa55a5", rows=32, columns=32, cell="u16")
    chunks = chunks_of(fine, rate_hz=60)
    assert sum(len(chunk.data) for chunk in chunks) > 0.9e6
    before_kb = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    begun_s = time.process_time()
    finding = search(chunks, (32, 32))
    assert time.process_time() - begun_s < 10.0
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before_kb < 200_000
    assert finding.proposed is not None
    assert (finding.proposed.rows, finding.proposed.columns) == (32, 32)


def test_baud_rates_rank_text_then_frames_then_nothing() -> None:
    text = b"".join(chunk.data for chunk in chunks_of(PRESETS["velostat"]))
    frames = b"".join(chunk.data for chunk in chunks_of(PRESETS["m1616"]))
    rates = [likelihood(data[:6000]) for data in (text, frames, RNG.bytes(6000), b"")]
    assert rates == sorted(rates, reverse=True)
    assert rates[0] > rates[1] > rates[2]
    assert likelihood(RNG.bytes(1000))[2]


def one_in(quick: int) -> pytest.MarkDecorator:
    """Parametrize `step`: the quick suite searches every quick-th stream, the slow suite each."""
    return pytest.mark.parametrize("step", [quick, pytest.param(1, marks=pytest.mark.slow)])


@needs_third_study
@one_in(5)
def test_light_touches_prove_a_coarse_pads_grid(step: int) -> None:
    judged = third_study(*JUDGED_ON)
    touching, still = ([each for _, touched, each in judged if touched is wanted] for wanted in (True, False))
    rests = [search(printed(each), (6, 6)).proposed for each in still[::step]]
    # One person did touch the pad while a recording of rest ran.
    assert sum(each is not None for each in rests) <= 1
    for clock in (True, False):
        touches = [search(printed(each, clock), (6, 6)).proposed for each in touching[::step]]
        found = [each for each in touches if each is not None]
        assert len(found) >= 0.8 * len(touches)
        assert {(each.rows, each.columns, each.skip, each.tail, each.invert) for each in found} == {
            (6, 6, int(clock), 0, False)
        }


@needs_third_study
@one_in(10)
def test_a_coarse_pads_shuffled_cells_are_hardly_ever_a_grid(step: int) -> None:
    rng = np.random.default_rng(0)
    proposed = []
    for _, _, each in third_study(*(JUDGED_ON if step > 1 else ()))[::step]:
        shuffled = np.hstack([each[:, :1], rng.permutation(each[:, 1:], axis=1)])
        proposed.append(search(printed(shuffled), (6, 6)).proposed is not None)
    assert sum(proposed) <= 0.03 * len(proposed)
