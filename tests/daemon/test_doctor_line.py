"""The doctor's checks of the pad's line: format, damage, rate."""

import termios
import time
from collections.abc import Callable
from functools import partial

import numpy as np
import pytest
from msgspec.structs import replace
from rigs.doctor_rig import SETTINGS, pad_at_baud, pad_of, pad_read_too_fast, resting, sample
from rigs.formats import encode_csv_line, encode_fabric_grid
from rigs.line_faults import Faults
from rigs.sensor_rig import Encode, as_8x8, noise, silence

from touchd.daemon.app.config import SensorSettings
from touchd.daemon.doctor import line
from touchd.daemon.doctor.check import Check, Sample, listen
from touchd.daemon.doctor.line import check_damage, check_protocol, check_rate
from touchd.drivers.fakes.fake_port import FakePort
from touchd.drivers.frame import Counts, Frame
from touchd.drivers.pad.format import PRESETS
from touchd.drivers.pad.parser import FrameParser
from touchd.drivers.pad.port import open_port
from touchd.drivers.search.listen import listen as hear
from touchd.drivers.search.search import search


@pytest.mark.parametrize(
    ("encode", "found", "advice"),
    [
        (as_8x8, "no frame of fabric-grid 10x10 in", "say --grid ROWSxCOLUMNS"),
        (encode_csv_line, "bytes/s of text, such as", "press"),
        (silence, "no data", "reset button"),
    ],
)
def test_a_line_without_frames_is_recognised(
    monkeypatch: pytest.MonkeyPatch, encode: Encode, found: str, advice: str
) -> None:
    monkeypatch.setattr(line, "USUAL_BAUDS", (9600,))
    check = protocol_of(pad_of(resting(60.0), encode, speed=3.0))
    assert check.verdict == "to do"
    assert found in check.found
    assert advice in check.advice


def test_silence_at_a_network_port_points_to_the_firewall() -> None:
    sensor = SensorSettings(port="udp://127.0.0.1:0")
    with open_port(sensor.port, sensor.baud) as opened:
        seen = listen(opened, FrameParser(sensor.described), 0.0, start_s=0.0)
        assert "ufw allow" in check_protocol(seen, sensor, opened, lambda: search([], None)).advice


def protocol_of(pad: FakePort, sensor: SensorSettings = SETTINGS.sensor) -> Check:
    with pad, open_port(pad.path, 512_000) as opened:
        seen = listen(opened, FrameParser(sensor.described), 1.0, start_s=1.5)
        return check_protocol(seen, sensor, opened, lambda: search(hear(opened, 1.0), None))


REST = np.zeros((3000, 8, 8), np.uint16)


@pytest.mark.parametrize(
    ("pad", "format"),
    [
        (partial(pad_at_baud, resting(60.0), termios.B115200), "fabric-grid"),
        # At twice the rate, frames of another pad seem to arrive.
        (partial(pad_read_too_fast, REST, termios.B115200, PRESETS["velostat"]), "velostat"),
    ],
)
def test_another_baud_rate_is_found_by_trying(pad: Callable[[], FakePort], format: str) -> None:
    assert protocol_of(pad(), SensorSettings(format=format)).advice == "set sensor.baud: 115200"


def after_garbage(counts: Counts, sensor_ms: int) -> bytes:
    return (b"" if sensor_ms else b"\x55" * 500) + encode_fabric_grid(counts, sensor_ms)


def test_listening_counts_from_the_first_frame_and_keeps_few_bytes(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("touchd.daemon.doctor.check.LATEST_BYTES", 1000)
    described = replace(SETTINGS.sensor.described, full_scale=500)
    with pad_of(resting(60.0), after_garbage, speed=9.0) as pad, open_port(pad.path, 512_000) as opened:
        seen = listen(opened, FrameParser(described), 0.5)
    assert len(seen.frames) > 20
    assert len(seen.data) == 1000
    assert (seen.damaged, seen.clipped) == (0, 1.0)


def test_listening_to_noise_ends_soon_after_its_first_bytes() -> None:
    with pad_of(resting(60.0), noise) as pad, open_port(pad.path, 512_000) as opened:
        begun_s = time.monotonic()
        assert listen(opened, FrameParser(SETTINGS.sensor.described), 0.2, start_s=60.0).data
        assert time.monotonic() - begun_s < 30.0


@pytest.mark.parametrize(
    ("faults", "verdict", "advice"),
    [
        (Faults(), "ok", ""),
        (Faults(flip_bit_every=100), "warning", ""),
        (Faults(flip_bit_every=10), "to do", "try a shorter cable"),
    ],
)
def test_a_line_that_damages_frames_is_recognised(faults: Faults, verdict: str, advice: str) -> None:
    check = check_damage(sample(resting(), faults=faults))
    assert check.verdict == verdict
    assert check.advice.startswith(advice)


def test_lost_frames_are_counted() -> None:
    check = check_rate(sample(resting(), faults=Faults(drop_frame_every=20)))
    assert check.found.endswith("; 21 frames lost on the way")
    assert check.verdict == "warning"


def test_bursts_that_end_touches_are_reported() -> None:
    frames = [Frame(1000 * (i // 54), i // 54, np.zeros((8, 8), np.uint16)) for i in range(400)]
    check = check_rate(Sample(tuple(frames), 0, b"", frames[-1].host_s))
    assert check.verdict == "warning"
    assert "gaps of up to 1000 ms" in check.found


@pytest.mark.parametrize(
    ("step_ms", "step_s", "late_s", "verdict", "found"),
    [
        (18, 0.009, 0.3, "to do", "its clock runs 2.00 times as fast"),
        (20.1, 0.0201, 0.0, "ok", "49.8 frames/s"),
        (25, 0.025, 0.0, "warning", "40.0 frames/s, jitter"),
        (140, 0.14, 0.0, "to do", "8 are needed"),
    ],
    ids=["wrong clock", "nominally 50 Hz", "slow", "useless"],
)
def test_a_wrong_clock_is_distinguished_from_a_slow_pad(
    step_ms: float, step_s: float, late_s: float, verdict: str, found: str
) -> None:
    frames = [Frame(round(step_ms * i), step_s * i, np.zeros((8, 8), np.uint16)) for i in range(400)]
    frames[-1] = replace(frames[-1], host_s=frames[-1].host_s + late_s)
    check = check_rate(Sample(tuple(frames), 0, b"", frames[-1].host_s))
    assert check.verdict == verdict
    assert found in check.found
    assert ("milliseconds" in check.advice, "54 Hz" in check.advice) == (late_s > 0, step_ms > 21)
