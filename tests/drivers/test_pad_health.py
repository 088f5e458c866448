"""A pad that breaks is noticed by its values, told once when it begins and once when it ends."""

import logging
import os
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from rigs.formats import FabricGrid, encode_fabric_grid
from rigs.haart_folder import needs_haart
from rigs.wait import WITHIN_S

from drivers.fakes.fake_port import FakePort
from drivers.frame import Counts, Frame
from drivers.pad.health import Finding, PadHealth
from drivers.pad.sensor import FrameQueue, Sensor
from drivers.pad.watch import PadWatch
from drivers.recording import Selection, Span, Stream, ideal_clock_ms, read_recordings, realign, splice

RATE_HZ = 54
Damage = Callable[[Counts], None]


def sound_pad(seconds: int) -> Counts:
    """A pad at rest as HAART's: a few counts of offset a taxel and noise on each."""
    rng = np.random.default_rng(5)
    rest = rng.uniform(1.0, 6.0, (8, 8))
    counts = np.rint(rest + rng.normal(0.0, 1.2, (seconds * RATE_HZ, 8, 8)))
    return np.clip(counts, 0, 1023).astype(np.uint16)


def findings_in(counts: Counts) -> list[tuple[int, Finding]]:
    """What is found in the frames, with the second it is told."""
    health = PadHealth()
    clock_ms = ideal_clock_ms(len(counts)).tolist()
    frames = [
        Frame(i, ms, 0.0, pressure) for i, (ms, pressure) in enumerate(zip(clock_ms, counts, strict=True))
    ]
    found = [(frame.sensor_ms // 1000, health.update(frame)) for frame in frames]
    return [(second, finding) for second, finding in found if finding is not None]


def stuck_taxel(counts: Counts) -> None:
    counts[:, 2, 4] = 300


def dead_row(counts: Counts) -> None:
    counts[:, 6] = 0


def dead_column(counts: Counts) -> None:
    counts[:, :, 0] = 0


def frozen(counts: Counts) -> None:
    counts[:] = counts[0]


def saturated(counts: Counts) -> None:
    counts[:, 2:6, 2:7] = 1023


def through_the_port(counts: Counts) -> list[Frame]:
    """Return the frames that the sensor reads of a pad with these counts."""
    stream = Stream(counts, ideal_clock_ms(len(counts)), (Span(0, len(counts), "notouch"),))
    queue = FrameQueue(len(counts) + 1)
    frames: list[Frame] = []
    with FakePort(stream, encode_fabric_grid, speed=None) as port:
        sensor = Sensor(port.path, 512000, FabricGrid(), queue)
        sensor.start()
        while len(frames) < len(counts):
            item = queue.get(WITHIN_S)
            assert item is not None
            if isinstance(item, Frame):
                frames.append(item)
        sensor.stop()
    return frames


def assert_logged(frames: list[Frame], what: str, caplog: pytest.LogCaptureFixture) -> None:
    """A person is warned once when it begins and told once when it is over."""
    caplog.set_level(logging.INFO)
    caplog.clear()
    watch = PadWatch()
    for frame in frames:
        watch.update(frame)
    lines = [(record.levelname, record.message) for record in caplog.records]
    assert lines == [("WARNING", what), ("INFO", f"no longer: {what}")]


@pytest.mark.parametrize(
    ("damage", "kind", "what"),
    [
        (stuck_taxel, "stuck taxel", "the taxel at row 3 column 5 stands still"),
        (dead_row, "dead line", "row 7 of the pad stands still: a broken wire?"),
        (dead_column, "dead line", "column 1 of the pad stands still: a broken wire?"),
        (frozen, "frozen", "frames arrive but no value changes"),
        (saturated, "saturated", "a quarter of the pad or more is at its limit"),
    ],
)
def test_a_broken_pad_and_its_repair_are_told_once(
    damage: Damage, kind: str, what: str, caplog: pytest.LogCaptureFixture
) -> None:
    counts = sound_pad(30)
    damage(counts[5 * RATE_HZ : 20 * RATE_HZ])
    frames = through_the_port(counts)
    health = PadHealth()
    told = [(frame, finding) for frame in frames if (finding := health.update(frame))]
    (begun, begin), (ended, end) = told
    assert (begin.kind, begin.began, end.kind, end.began) == (kind, True, kind, False)
    assert begin.what.startswith(what)
    assert 5_000 < begun.sensor_ms < 18_000
    assert 20_000 < ended.sensor_ms < 25_000
    np.testing.assert_array_equal(frames[-1].pressure, counts[-1])
    assert_logged(frames, begin.what, caplog)


def test_a_heavy_still_hand_breaks_nothing() -> None:
    counts = sound_pad(20)
    counts[5 * RATE_HZ : 15 * RATE_HZ, 1:5, 1:5] += 600
    assert findings_in(counts) == []


def test_an_intermittent_contact_is_no_flood() -> None:
    counts = sound_pad(60)
    for second in range(5, 60, 2):
        stuck_taxel(counts[second * RATE_HZ : (second + 1) * RATE_HZ])
    assert len(findings_in(counts)) <= 1


def test_several_broken_taxels_are_one_finding() -> None:
    counts = sound_pad(20)
    counts[:, [0, 2, 3, 5, 7], [1, 1, 6, 5, 0]] = 0
    ((_, finding),) = findings_in(counts)
    assert finding.what == (
        "the taxel at row 1 column 2, row 3 column 2, row 4 column 7, row 6 column 6 and 1 more stands still"
    )


def test_a_pad_that_is_silent_at_rest_is_not_broken() -> None:
    counts = np.zeros((60 * RATE_HZ, 8, 8), np.uint16)
    counts[20 * RATE_HZ : 25 * RATE_HZ, 2:5, 2:5] = 200 + sound_pad(5)[:, 2:5, 2:5]
    assert findings_in(counts) == []


def test_a_creeping_rest_and_its_return_are_told_once(caplog: pytest.LogCaptureFixture) -> None:
    counts = sound_pad(300)
    creep = np.concatenate([np.zeros(80), np.linspace(0, 40, 100), np.zeros(120)])
    counts += np.repeat(creep, RATE_HZ).astype(np.uint16)[:, None, None]
    frames = through_the_port(counts)
    health = PadHealth()
    told = [(frame.sensor_ms / 1000, finding) for frame in frames if (finding := health.update(frame))]
    (begun_s, begin), (ended_s, end) = told
    assert (begin.kind, begin.began, end.began) == ("drift", True, False)
    assert 80 < begun_s < 180 < ended_s < 270
    np.testing.assert_array_equal(frames[-1].pressure, counts[-1])
    assert_logged(frames, begin.what, caplog)
    assert "the level at rest rose by" in begin.what


def test_a_clock_that_starts_again_does_no_harm() -> None:
    health = PadHealth()
    counts = sound_pad(20)
    clock_ms = np.concatenate([ideal_clock_ms(540, 2**32 - 3000) % 2**32, ideal_clock_ms(540)]).tolist()
    assert [
        finding
        for pressure, ms in zip(counts, clock_ms, strict=True)
        if (finding := health.update(Frame(0, ms, 0.0, pressure)))
    ] == []


@needs_haart
def test_in_ten_minutes_of_real_touches_nothing_is_found_broken() -> None:
    path = Path(os.environ["TOUCHD_HAART"]) / "testWITHLABELS.csv.gz"
    recordings = [realign(recording) for recording in read_recordings(path, Selection(participants=("T9",)))]
    counts = splice(recordings).counts
    assert len(counts) > 10 * 60 * RATE_HZ
    assert findings_in(counts) == []
