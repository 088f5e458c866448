"""Faults of a pad's line, clock and values are reported as one state and a few log lines."""

import logging
import signal
import time
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rigs.formats import FabricGrid, encode_fabric_grid
from rigs.haart_folder import needs_haart, recordings_of
from rigs.line_faults import Faults
from rigs.made_pad import MadePad, nothing
from rigs.patient_port import playing
from rigs.running_daemon import Daemon, run_daemon
from rigs.sensor_rig import stream_of

from touchd.daemon.app.config import SensorSettings, Settings
from touchd.daemon.path.events import SensorEvent
from touchd.daemon.path.monitor import COMPARE_S, NOISY_CHECKS, PadMonitor, TaxelFaults
from touchd.daemon.path.tracker.tracker import CHECK_FRAMES
from touchd.daemon.playback.rig import encoder_for
from touchd.drivers.fakes.encode import encode_frame
from touchd.drivers.fakes.fake_port import FakePort
from touchd.drivers.faults import AGAIN_S
from touchd.drivers.frame import CLOCK_MODULUS, Counts, Frame, SensorState
from touchd.drivers.pad.format import PadFormat
from touchd.drivers.pad.grid import MAX_GAP_MS
from touchd.drivers.pad.parser import FrameParser
from touchd.drivers.recording import Stream, ideal_clock_ms, read_recordings, realign, splice

RATE_HZ = 54
DEAD_ROW = "row 7 of the 8x8 grid stands still: a broken wire?"
# Frames, rows and columns.
A_TAXEL, ROW_7, SATURATED = np.s_[:, 2, 4], np.s_[:, 6], np.s_[:, 2:6, 2:7]


def sound_pad(seconds: int) -> Counts:
    return MadePad(5).counts(nothing(seconds))


def frames_of(counts: Counts, clock_ms: Iterable[int] | None = None) -> list[Frame]:
    clock_ms = ideal_clock_ms(len(counts)).tolist() if clock_ms is None else clock_ms
    return [Frame(ms, ms / 1000, pressure) for ms, pressure in zip(clock_ms, counts, strict=True)]


def faults_in(counts: Counts, clock_ms: Iterable[int] | None = None) -> list[tuple[float, str, bool]]:
    """Return the second on the pad's clock, the words and whether it begins, for each change of a fault."""
    taxels, found = TaxelFaults(), list[tuple[float, str, bool]]()
    for frame in frames_of(counts, clock_ms):
        before = dict(taxels.faults)
        taxels.update(frame)
        for kind in before.keys() ^ taxels.faults.keys():
            what = (before | taxels.faults)[kind]
            found.append((frame.sensor_ms / 1000, what, kind in taxels.faults))
    return found


def logged(counts: Counts, caplog: pytest.LogCaptureFixture) -> list[tuple[int, str, str]]:
    """Return each log line's second, level and message."""
    caplog.set_level(logging.INFO)
    monitor, lines = PadMonitor(), list[tuple[int, str, str]]()
    for frame in frames_of(counts):
        caplog.clear()
        monitor.on_frame(frame, restarted=False)
        lines += [(frame.sensor_ms // 1000, record.levelname, record.message) for record in caplog.records]
    return lines


def is_begin_and_end(lines: list[tuple[int, str, str]], fault: str) -> bool:
    """Whether these log lines are of one fault that begins and ends."""
    (_, begin, first), (_, end, last) = lines
    ended = f"no longer: {fault} (after "
    return (begin, first, end) == ("WARNING", fault, "INFO") and last.startswith(ended)


def pad_with_dead_row(seconds: int, *broken: tuple[int, int]) -> Counts:
    """A pad whose seventh row is dead in each of these spans of seconds."""
    counts = sound_pad(seconds)
    for begin_s, end_s in broken:
        counts[begin_s * RATE_HZ : end_s * RATE_HZ][ROW_7] = 0
    return counts


@pytest.mark.parametrize(
    ("where", "stuck_at", "what"),
    [
        (A_TAXEL, 300, "the taxel at row 3 column 5 of the 8x8 grid stands still"),
        (ROW_7, 0, "row 7 of the 8x8 grid stands still: a broken wire?"),
        (np.s_[:, :, 0], 0, "column 1 of the 8x8 grid stands still: a broken wire?"),
        (np.s_[:], sound_pad(1)[0], "frames arrive but no value changes"),
        (SATURATED, 1023, "a quarter of the pad or more is at its limit"),
    ],
    ids=["taxel", "row", "column", "frozen", "saturated"],
)
def test_a_broken_pad_and_its_repair_are_reported_once(
    where: Any, stuck_at: Any, what: str, caplog: pytest.LogCaptureFixture
) -> None:
    counts = sound_pad(30)
    counts[5 * RATE_HZ : 20 * RATE_HZ][where] = stuck_at
    (begun_s, begin, is_begin), (ended_s, end, is_still_there) = faults_in(counts)
    assert (is_begin, end, is_still_there) == (True, begin, False)
    assert begin.startswith(what)
    assert 5 < begun_s < 18
    assert 20 < ended_s < 25
    assert is_begin_and_end(logged(counts, caplog), begin)


@pytest.mark.parametrize(("cells", "load"), [(1, 0), (6, 0), (64, 0), (6, 900)])
def test_values_that_jump_from_frame_to_frame_degrade_the_pad(cells: int, load: int) -> None:
    rng = np.random.default_rng(3)
    counts = sound_pad(40) + np.uint16(load)
    for frame in counts[5 * RATE_HZ : 20 * RATE_HZ]:
        if rng.random() < 2 / 3:
            frame.reshape(-1)[rng.choice(64, cells, replace=False)] = rng.integers(0, 1024, cells)
    monitor = PadMonitor()
    told = [(frame.sensor_ms / 1000, monitor.on_frame(frame, restarted=False)) for frame in frames_of(counts)]
    (begun_s, begun), (ended_s, ended) = [(second, state) for second, state in told if state is not None]
    assert (begun.state, begun.cause, ended.state) == ("degraded", "garbled", "up")
    assert 6 < begun_s < 12
    assert 20 < ended_s < 28


@pytest.mark.parametrize(
    ("cells", "jump", "is_said"), [(1, 100, True), (1, 99, False), (64, 100, True), (64, 99, False)]
)
def test_jumps_of_a_hundred_counts_a_frame_are_said(cells: int, jump: int, is_said: bool) -> None:
    counts = sound_pad(20)
    counts[:] = counts[0]
    counts.reshape(-1, 64)[1::2, :cells] += np.uint16(jump)
    assert bool([what for _, what, _ in faults_in(counts) if "jump" in what]) == is_said


@pytest.mark.parametrize(("every_ms", "is_said"), [(24.5, True), (25.5, False)])
def test_below_forty_frames_a_second_a_jump_may_be_a_pat(every_ms: float, is_said: bool) -> None:
    counts = sound_pad(20)
    counts[1::2, 2:4, 2:4] += np.uint16(300)
    clock_ms = np.rint(every_ms * np.arange(len(counts))).astype(int).tolist()
    assert bool([what for _, what, _ in faults_in(counts, clock_ms) if "jump" in what]) == is_said


@pytest.mark.parametrize(("load", "is_said"), [(500, True), (800, False)])
def test_noise_of_less_than_half_a_load_is_not_a_jump(load: int, is_said: bool) -> None:
    counts = np.full((20 * RATE_HZ, 8, 8), load, np.uint16)
    counts[1::2, 2:4, 2:4] += np.uint16(270)
    assert bool([what for _, what, _ in faults_in(counts) if "jump" in what]) == is_said


def test_a_garbled_line_that_gets_better_is_garbled_until_it_is_good() -> None:
    seldom = sound_pad(60)
    seldom[::4, 2:4, 2:4] += np.uint16(300)
    assert faults_in(seldom) == []
    often = seldom.copy()
    often[5 * RATE_HZ : 15 * RATE_HZ : 2, 2:4, 2:4] = 500
    often[40 * RATE_HZ :] = sound_pad(20)
    (begun_s, _, begins), (ended_s, _, begins_again) = faults_in(often)
    assert (begins, begins_again) == (True, False)
    assert 5 < begun_s < 12
    assert 40 < ended_s < 46


@pytest.mark.parametrize(
    ("taxels", "counts", "is_said"), [(16, 1000, True), (16, 999, False), (15, 1023, False)]
)
def test_a_quarter_of_the_pad_at_its_limit_is_said(taxels: int, counts: int, is_said: bool) -> None:
    pad = sound_pad(15)
    pad.reshape(-1, 64)[:, :taxels] = counts
    assert any("at its limit" in what for _, what, _ in faults_in(pad)) == is_said


@pytest.mark.parametrize(("lively", "is_said"), [(48, True), (47, False)])
def test_on_a_pad_with_noise_in_three_quarters_of_its_taxels_a_still_one_is_broken(
    lively: int, is_said: bool
) -> None:
    counts = np.full((20 * RATE_HZ, 64), 10, np.uint16)
    counts[1::2, :lively] += 1
    assert bool(faults_in(counts.reshape(-1, 8, 8))) == is_said


@pytest.mark.parametrize("taps_hz", [4.0, 8.0])
@pytest.mark.parametrize("rate_hz", [12.0, 25.0, 54.0, 100.0])
def test_a_quick_hand_does_not_garble_a_pad(rate_hz: float, taps_hz: float) -> None:
    second = np.arange(round(20 * rate_hz)) / rate_hz
    counts = MadePad(5).counts(np.zeros((len(second), 8, 8), np.float32))
    counts[:, 2:5, 2:5] += ((second * taps_hz % 1 < 0.4) * 300).astype(np.uint16)[:, None, None]
    clock_ms = np.rint(1000 * second).astype(int).tolist()
    assert not [what for _, what, _ in faults_in(counts, clock_ms) if "jump" in what]


def test_noise_on_every_taxel_is_not_a_garbled_line() -> None:
    counts = sound_pad(20)
    counts += np.random.default_rng(2).integers(0, 35, counts.shape).astype(np.uint16)
    assert faults_in(counts) == []


def test_a_heavy_still_hand_is_not_a_fault() -> None:
    counts = sound_pad(20)
    counts[5 * RATE_HZ : 15 * RATE_HZ, 1:5, 1:5] += 600
    assert faults_in(counts) == []


def test_a_load_often_at_the_limit_is_not_a_fault() -> None:
    counts = sound_pad(30)
    for first in range(0, 30 * RATE_HZ, 9):
        counts[first : first + 6][SATURATED] = 1023
    assert faults_in(counts) == []


def test_a_load_that_wavers_at_the_limit_is_one_finding() -> None:
    counts = sound_pad(40)
    counts[5 * RATE_HZ : 15 * RATE_HZ][SATURATED] = 1023
    for first in range(15 * RATE_HZ, 40 * RATE_HZ, 10):
        counts[first : first + 7][SATURATED] = 1023
    assert [is_begin for _, _, is_begin in faults_in(counts)] == [True]


def test_a_firm_fingertip_at_the_limit_is_not_a_fault() -> None:
    counts = sound_pad(20)
    fingertip = counts[5 * RATE_HZ :, 2:5, 2:5]
    fingertip[:] = np.random.default_rng(1).integers(1000, 1024, fingertip.shape)
    assert faults_in(counts) == []


def test_a_stuck_taxel_that_twitches_is_one_finding() -> None:
    counts = sound_pad(90)
    counts[5 * RATE_HZ :, 3, 3] = 100
    # It twitches in every fortieth frame, for ten seconds at a time.
    for first in range(30 * RATE_HZ, 90 * RATE_HZ, 20 * RATE_HZ):
        counts[first : first + 10 * RATE_HZ : 40, 3, 3] = 101
    assert [is_begin for _, _, is_begin in faults_in(counts)] == [True]


def test_an_intermittent_contact_does_not_flood_the_log() -> None:
    counts = sound_pad(60)
    for second in range(5, 60, 2):
        counts[second * RATE_HZ : (second + 1) * RATE_HZ][A_TAXEL] = 300
    assert len(faults_in(counts)) <= 1


def test_several_broken_taxels_are_one_finding() -> None:
    counts = sound_pad(20)
    counts[:, [0, 2, 3, 5, 7], [1, 1, 6, 5, 0]] = 0
    ((_, what, _),) = faults_in(counts)
    assert what == (
        "the taxel at row 1 column 2, row 3 column 2, row 4 column 7, row 6 column 6 and 1 more of the 8x8 "
        "grid stands still"
    )


def test_a_pad_that_is_silent_at_rest_is_not_broken() -> None:
    counts = np.zeros((60 * RATE_HZ, 8, 8), np.uint16)
    counts[20 * RATE_HZ : 25 * RATE_HZ, 2:5, 2:5] = 200 + sound_pad(5)[:, 2:5, 2:5]
    assert faults_in(counts) == []


def test_a_whole_hand_on_a_silent_pad_is_tolerated() -> None:
    counts = np.zeros((60 * RATE_HZ, 8, 8), np.uint16)
    # It rubs, then lies still.
    counts[10 * RATE_HZ : 20 * RATE_HZ] = 200 + sound_pad(10)
    counts[20 * RATE_HZ : 40 * RATE_HZ] = 200
    assert faults_in(counts) == []


@pytest.mark.parametrize("noise_counts", [0.1, 0.2, 0.3, 0.4])
def test_a_hand_on_a_quiet_pad_is_not_a_fault(noise_counts: float) -> None:
    rng = np.random.default_rng(3)
    level = rng.uniform(10, 20, (8, 8)) + noise_counts * rng.standard_normal((120 * RATE_HZ, 8, 8))
    level[10 * RATE_HZ : 20 * RATE_HZ] += sound_pad(10)
    assert faults_in(np.rint(level).astype(np.uint16)) == []


def test_a_restarting_clock_does_no_harm() -> None:
    clock_ms = [*(ideal_clock_ms(540, 2**32 - 3000) % 2**32).tolist(), *ideal_clock_ms(540).tolist()]
    assert faults_in(sound_pad(20), clock_ms) == []


def test_the_daemon_logs_a_dead_row_and_its_return_once(tmp_path: Path) -> None:
    counts = pad_with_dead_row(32, (4, 20))
    with playing(Stream(counts, ideal_clock_ms(len(counts)), ()), speed=100.0) as port:
        events, log = run_daemon(Settings(sensor=SensorSettings(port=port.path)), tmp_path, port)
    begin, end = (line for line in log.splitlines() if "stands still" in line)
    assert begin == f"WARNING touchd.daemon.path.monitor: {DEAD_ROW}"
    assert end.startswith(f"INFO touchd.daemon.path.monitor: no longer: {DEAD_ROW}")
    assert {type(event) for event in events} <= {SensorEvent}


def test_a_loose_wire_is_logged_ever_less_often(caplog: pytest.LogCaptureFixture) -> None:
    counts = pad_with_dead_row(300, *((begin_s, begin_s + 12) for begin_s in range(5, 280, 30)))
    assert is_begin_and_end(logged(counts, caplog), DEAD_ROW)


def test_a_wire_that_breaks_for_good_is_logged_again(caplog: pytest.LogCaptureFixture) -> None:
    first, again = logged(pad_with_dead_row(330, (5, 20), (40, 330)), caplog)[::2]
    assert (first[1:], again[1:]) == (("WARNING", DEAD_ROW), ("WARNING", DEAD_ROW))
    assert AGAIN_S <= again[0] - first[0] < AGAIN_S + 2


@needs_haart
def test_ten_minutes_of_real_touches_have_no_finding(tmp_path: Path) -> None:
    path = recordings_of("testWITHLABELS.csv", "T9,", tmp_path)
    recordings = [realign(recording) for recording in read_recordings(path)]
    counts = splice(recordings).counts
    assert len(counts) > 10 * 60 * RATE_HZ
    assert faults_in(counts) == []


SENT = PadFormat(framing="text", rows=8, columns=8, skip=1, clock="ms", full_scale=4095)
CONFIGURED = PadFormat(framing="text", rows=8, columns=8, skip=1, clock="ms", full_scale=1023)
SET = "if firm presses do that, set a larger one in sensor.format"
ABOVE = f"COM3: values above full_scale 1023 are cut to it; {SET}"
MANY = "5% of the last frames were damaged on the way"
TRY = "try a shorter cable and another USB port, no hub; does another program read it too (fuser)?"
UDP = "udp://0.0.0.0:4000"


def watch(parser: FrameParser, packets: list[bytes], where: str = "COM3", intervals: int = 1) -> None:
    """After a first frame, spread the packets over some check intervals."""
    monitor = PadMonitor(parser=parser, where=where)
    still = np.zeros((8, 8), np.uint16)
    monitor.on_frame(Frame(0, 0.0, still), restarted=False)
    for number, packet in enumerate(packets, 1):
        now_s = COMPARE_S * intervals * number / len(packets)
        parser.feed(packet, now_s)
        monitor.on_frame(Frame(round(1000 * now_s), now_s, still), restarted=False)


def pressed(counts: int, numbers: range) -> list[bytes]:
    frame = np.full((8, 8), counts, np.uint16)
    return [encode_frame(SENT, frame, round(1000 * number / 54)) for number in numbers]


def firm_presses(first: int) -> list[bytes]:
    return pressed(100, range(first, first + 420)) + pressed(900, range(first + 420, first + 540))


def later(count: int) -> Iterator[tuple[Counts, int]]:
    """Return frames that follow those of `faulty`."""
    stream = stream_of(540 + count)
    return zip(stream.counts[540:], stream.sensor_ms[540:].tolist(), strict=True)


def faulty(**every: int) -> list[bytes]:
    faults, stream = Faults(**every), stream_of(540)
    sent = zip(stream.counts, stream.sensor_ms.tolist(), strict=True)
    return [faults.on_line(number, encode_fabric_grid(*frame)) for number, frame in enumerate(sent, 1)]


@pytest.mark.parametrize(
    ("parser", "packets", "where", "warning"),
    [
        (FrameParser(CONFIGURED), firm_presses(0), "COM3", ABOVE),
        (FabricGrid(), faulty(flip_bit_every=20), "COM3", f"COM3: {MANY}; {TRY}"),
        (FabricGrid(), faulty(flip_bit_every=20), UDP, f"{UDP}: {MANY}; does another board send there too?"),
        (FabricGrid(), faulty(), "COM3", None),
        (FabricGrid(), faulty(flip_bit_every=100), "COM3", None),
        (FabricGrid(), faulty(repeat_frame_every=5), "COM3", None),
    ],
    ids=["firm presses", "damage", "damage on a network", "sound", "little damage", "repeats"],
)
def test_frames_lost_on_the_line_are_logged_with_advice(
    parser: FrameParser,
    packets: list[bytes],
    where: str,
    warning: str | None,
    caplog: pytest.LogCaptureFixture,
) -> None:
    watch(parser, packets, where)
    assert caplog.messages == ([warning] if warning else [])


def test_continuing_losses_on_the_line_are_logged_once(caplog: pytest.LogCaptureFixture) -> None:
    presses = [packet for turn in range(20) for packet in firm_presses(540 * turn)]
    watch(FrameParser(CONFIGURED), presses, intervals=20)
    assert caplog.messages == [ABOVE]


@pytest.mark.parametrize(
    ("parser", "packets"),
    [
        (FrameParser(CONFIGURED), firm_presses(0) + pressed(100, range(540, 1620))),
        (
            FabricGrid(),
            faulty(flip_bit_every=20)[:540] + [encode_fabric_grid(*frame) for frame in later(1080)],
        ),
    ],
    ids=["firm presses", "damage"],
)
def test_a_line_that_is_sound_again_is_logged(
    parser: FrameParser, packets: list[bytes], caplog: pytest.LogCaptureFixture
) -> None:
    caplog.set_level(logging.INFO)
    watch(parser, packets, intervals=3)
    begin, end = caplog.messages
    assert end.startswith(f"no longer: {begin} (after 10.0 s)")


@pytest.mark.parametrize(("every_s", "is_often"), [(29.0, True), (31.0, False)])
def test_a_pad_that_often_restarts_is_degraded_until_it_is_steady(every_s: float, is_often: bool) -> None:
    parser, states, still = FabricGrid(), list[SensorState | None](), np.zeros((8, 8), np.uint16)
    monitor = PadMonitor(parser=parser, where="COM3")
    for tenth in range(1400):
        if tenth in (10, 10 + 10 * every_s, 10 + 20 * every_s):
            parser.counts.restarts += 1
        states.append(monitor.on_frame(Frame(100 * tenth, tenth / 10, still), restarted=False))
    told = [(state.state, state.cause) for state in states if state is not None]
    assert told == ([("degraded", "restarts"), ("up", "")] if is_often else [])


def test_frames_refused_during_an_outage_are_not_a_fault(caplog: pytest.LogCaptureFixture) -> None:
    parser, still = FabricGrid(), np.zeros((8, 8), np.uint16)
    monitor = PadMonitor(parser=parser)
    monitor.on_frame(Frame(0, 0.0, still), restarted=False)
    for packet in faulty(flip_bit_every=3):
        parser.feed(packet, 10.0)
    monitor.on_frame(Frame(0, 3 * COMPARE_S, still), restarted=True)
    assert caplog.messages == []


@pytest.mark.parametrize("restarts", [0, 1])
def test_what_a_board_prints_as_it_restarts_is_not_damage(
    restarts: int, caplog: pytest.LogCaptureFixture
) -> None:
    parser, still = FabricGrid(), np.zeros((8, 8), np.uint16)
    monitor = PadMonitor(parser=parser, where="COM3")
    for second in range(round(1.5 * COMPARE_S)):
        monitor.on_frame(Frame(1000 * second, float(second), still), restarted=False)
        parser.counts.frames += 54
        parser.counts.damaged += 5
        parser.counts.restarts = restarts
    assert any("damaged" in message for message in caplog.messages) == (not restarts)


def states_of(monitor: PadMonitor, times_ms: Iterable[int], at_s: float = 0.0) -> list[SensorState]:
    """Return how the pad's state changes while frames arrive at these times of its clock."""
    states, last_ms = list[SensorState | None](), -1000
    for ms in times_ms:
        frame = Frame(ms % CLOCK_MODULUS, at_s + ms / 1000, np.zeros((8, 8), np.uint16))
        states.append(monitor.on_frame(frame, restarted=not 0 < ms - last_ms <= MAX_GAP_MS))
        last_ms = ms
    return [state for state in states if state is not None]


def test_losing_frames_in_runs_degrades_the_pad() -> None:
    monitor = PadMonitor()
    # 20 of 30 frames arrive, at 54 Hz.
    (state,) = states_of(monitor, [round(1000 / 54 * i) for i in range(600) if i % 30 < 20])
    assert (state.state, state.cause) == ("degraded", "gaps")
    assert "gaps of up to 20" in state.reason
    assert "frames lost on the way" in state.reason
    (state,) = states_of(monitor, range(12_000, 14_000, 18))
    assert state.state == "up"


def test_a_single_gap_is_not_a_fault() -> None:
    monitor = PadMonitor()
    for at_ms in (0, 6000, 12_000):
        assert states_of(monitor, range(at_ms, at_ms + 5500, 18)) == []


def test_two_boards_on_one_line_degrade_the_pad() -> None:
    times_ms = [ms + 700_000 * (number % 2) for number, ms in enumerate(range(0, 5000, 18))]
    monitor, states = PadMonitor(), list[SensorState | None]()
    for number, ms in enumerate(times_ms):
        frame = Frame(ms, number * 0.018, np.zeros((8, 8), np.uint16))
        states.append(monitor.on_frame(frame, restarted=True))
    (state,) = filter(None, states)
    assert state.cause == "gaps"
    assert "the pad's clock goes back and forth" in state.reason


def test_gaps_in_frames_that_were_read_together_degrade_the_pad() -> None:
    monitor, states = PadMonitor(), list[SensorState | None]()
    for number in range(90):
        frame = Frame(300 * number, 1.5 * (number // 30), np.zeros((8, 8), np.uint16))
        states.append(monitor.on_frame(frame, restarted=True))
    (state,) = filter(None, states)
    # The 27 last frames came in two reads, 1.5 s apart.
    assert "17 frames a second come, with gaps of up to 300 ms" in state.reason


def test_a_pad_that_is_too_slow_is_degraded() -> None:
    (state,) = states_of(PadMonitor(), range(0, 10_000, 250))
    assert "4.0 frames a second come, and 8 or more are needed" in state.reason


def test_a_steady_pad_below_the_least_rate_is_degraded() -> None:
    (state,) = states_of(PadMonitor(), range(0, 10_000, 160))
    assert "6.2 frames a second come, and 8 or more are needed" in state.reason
    assert states_of(PadMonitor(), range(0, 10_000, 125)) == []


def test_a_hand_does_not_show_which_taxels_stand_still() -> None:
    silent = np.zeros((20 * RATE_HZ, 8, 8), np.uint16)
    silent[: 5 * RATE_HZ] = sound_pad(5)
    taxels = TaxelFaults()
    for number, frame in enumerate(frames_of(silent)):
        taxels.update(frame, is_untouched=number >= 5 * RATE_HZ)
    assert taxels.faults == {}


def test_a_row_that_broke_on_a_slow_pad_is_found_between_touches() -> None:
    taxels = TaxelFaults()
    # Ten frames a second; a hand and what it leaves take four of every six seconds.
    for number, frame in enumerate(pad_with_dead_row(20, (10, 20))):
        at_ms = 100 * number
        taxels.update(Frame(at_ms, at_ms / 1000, frame), is_untouched=at_ms % 6000 < 2000)
        assert taxels.faults == {} or number > 10 * RATE_HZ
    assert list(taxels.faults) == ["dead line"]


def test_stale_frames_after_a_pause_are_not_judged() -> None:
    monitor = PadMonitor()
    assert states_of(monitor, range(0, 5000, 18)) == []
    # Ten frames waited in the port's buffer; those after them were lost.
    assert states_of(monitor, range(5000, 5180, 18), at_s=20.0) == []
    assert states_of(monitor, range(25_300, 30_000, 18)) == []


def test_a_daemon_that_was_stopped_blames_neither_pad_nor_clock(tmp_path: Path) -> None:
    counts = sound_pad(60)
    stream = Stream(counts, ideal_clock_ms(len(counts)), ())
    with FakePort(stream, encoder_for(SensorSettings())) as pad, Daemon(tmp_path, pad) as daemon:
        daemon.await_event(SensorEvent)
        time.sleep(1.0)
        daemon.process.send_signal(signal.SIGSTOP)
        time.sleep(3.0)
        daemon.process.send_signal(signal.SIGCONT)
        time.sleep(1.5)
        assert daemon.stop() == 0
    assert [event.state for event in daemon.events if isinstance(event, SensorEvent)] == ["up"]
    assert [line for line in daemon.log.splitlines() if "drivers.pad" in line and "WARNING" in line] == []


def test_a_noisy_pad_is_degraded_after_five_seconds() -> None:
    monitor = PadMonitor()
    for check in range(90):
        monitor.on_rest(is_noisy=True, loose_lines=())
        if states_of(monitor, [check]):
            break
    assert check * CHECK_FRAMES / RATE_HZ == pytest.approx(5, abs=0.2)


def test_a_noisy_pad_is_degraded_until_it_is_calm() -> None:
    monitor = PadMonitor()
    for is_noisy, state in ((True, "degraded"), (False, "up")):
        for _ in range(NOISY_CHECKS - 1):
            monitor.on_rest(is_noisy=is_noisy, loose_lines=())
        assert states_of(monitor, [0]) == []
        monitor.on_rest(is_noisy=is_noisy, loose_lines=())
        assert [now.state for now in states_of(monitor, [0])] == [state]


def test_a_pad_that_is_calm_in_between_is_not_noisy() -> None:
    monitor = PadMonitor()
    for is_noisy in (True, False, True):
        for _ in range(1 if not is_noisy else NOISY_CHECKS - 1):
            monitor.on_rest(is_noisy=is_noisy, loose_lines=())
        assert states_of(monitor, [0]) == []
    monitor.on_rest(is_noisy=True, loose_lines=())
    assert [now.state for now in states_of(monitor, [0])] == ["degraded"]


def test_a_pad_that_was_gone_is_not_noisy_until_measured_again(caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level(logging.INFO)
    monitor = PadMonitor()
    for _ in range(NOISY_CHECKS):
        monitor.on_rest(is_noisy=True, loose_lines=())
    assert [now.state for now in states_of(monitor, [0])] == ["degraded"]
    monitor.on_sensor(SensorState("down", "unplugged"))
    monitor.on_sensor(SensorState("up", ""))
    assert states_of(monitor, [10_000]) == []
    assert "no longer" not in caplog.text


def test_a_graver_cause_of_a_degraded_pad_is_reported() -> None:
    monitor = PadMonitor()
    for _ in range(NOISY_CHECKS):
        monitor.on_rest(is_noisy=True, loose_lines=())
    states = states_of(monitor, range(0, 10_000, 250))
    assert [state.cause for state in states] == ["noise", "gaps"]


def test_each_lasting_cause_of_an_outage_is_reported_once(
    caplog: pytest.LogCaptureFixture,
) -> None:
    monitor = PadMonitor()
    causes = ("missing", "denied", "missing", "busy", "busy", "busy", "missing", "missing")
    states = [monitor.on_sensor(SensorState("down", cause, cause)) for cause in causes]
    assert [state.reason for state in states if state] == ["missing", "busy"]
    assert caplog.messages == ["missing", "busy"]
