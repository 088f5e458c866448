"""Checks of the pad's line: port, protocol, damage and frame rate."""

import os
from collections.abc import Callable
from contextlib import suppress

import numpy as np

from touchd.daemon.app.config import SensorSettings
from touchd.daemon.doctor.check import START_S, Check, Sample, listen
from touchd.daemon.doctor.port import advice_for
from touchd.daemon.doctor.values import MANY_SHARE
from touchd.drivers.frame import MIN_RATE_HZ
from touchd.drivers.pace import pace_of, relative_clock, steps_ms
from touchd.drivers.pad.grid import MAX_GAP_MS
from touchd.drivers.pad.parser import FrameParser
from touchd.drivers.pad.port import Port, SensorError, at_baud, check_port, discard_input, open_port
from touchd.drivers.search.listen import USUAL_BAUDS
from touchd.drivers.search.search import Finding, as_yaml
from touchd.drivers.search.text import is_text

TRY_BAUD_S = 0.5
# Any rate from 8 Hz on is resampled to 54 Hz; answers are best from this one on.
SLOW_HZ = 50.0
# One lost frame in a thousand is harmless.
CLEAN_SHARE = 0.001
CLOCK_TOLERANCE = 0.05
STOPPED_S = 1.0
SCAN_FASTER = "have the firmware scan at 54 Hz; at 115200 baud a 10x10 frame just fits: use 512000"
SEND_A_CLOCK = "flash the pad's firmware again: each frame must carry the milliseconds since its start"


def check_opening(sensor: SensorSettings) -> tuple[Check, Port | None]:
    """Open the port; report the device behind a link, or why opening failed and which ports there are."""
    try:
        check_port(sensor.port, sensor.baud)
        opened = open_port(sensor.port, sensor.baud)
    except SensorError as error:
        return Check("port", "to do", str(error), advice_for(sensor.port, error)), None
    device = f" ({os.path.realpath(sensor.port)})" if os.path.islink(sensor.port) else ""
    return Check("port", "ok", f"{sensor.port}{device}, found and permitted"), opened


def check_protocol(
    sample: Sample, sensor: SensorSettings, opened: Port, find: Callable[[], Finding]
) -> Check:
    """Report whether frames were decoded; if not, try other baud rates, then search for another format.

    find: asks for a hand on the pad and searches what it sends.
    """
    described = sensor.described
    if sample.frames:
        return Check("protocol", "ok", f"{described}{at_baud(sensor.port, sensor.baud)}, as configured")
    if not sample.data:
        advice = "is it the pad's port? press the reset button of its board; unplug it; flash its firmware"
        if sensor.port.startswith("udp://"):
            number = sensor.port.rpartition(":")[2]
            advice = f"does the board send to this computer, port {number}? sudo ufw allow {number}/udp"
        return Check("protocol", "to do", f"no data within {START_S:g} s", advice)
    has_bauds = not is_text(sample.data) and "://" not in sensor.port
    if has_bauds and (baud := _other_baud(sensor, opened)):
        return Check("protocol", "to do", f"{described}, but at {baud} baud", f"set sensor.baud: {baud}")
    finding = find()
    found = f"no frame of {described} in {finding.arrived}"
    if finding.proposed is not None:
        return Check("protocol", "to do", found, f"set under sensor: {as_yaml(finding.proposed)}")
    tried = f"; baud rates tried: {', '.join(map(str, sorted(USUAL_BAUDS)))}" if has_bauds else ""
    return Check("protocol", "to do", found, f"{finding.missing}{tried}")


def _other_baud(sensor: SensorSettings, opened: Port) -> int | None:
    """Return the usual baud rate at which frames are decoded, or None."""
    for baud in (each for each in USUAL_BAUDS if each != sensor.baud):
        with suppress(OSError, ValueError):
            opened.baudrate = baud
            discard_input(opened)
            if listen(opened, FrameParser(sensor.described), TRY_BAUD_S, start_s=TRY_BAUD_S).frames:
                return baud
    return None


def check_damage(sample: Sample) -> Check:
    """Report how many frames were damaged."""
    share = sample.damaged / (sample.damaged + len(sample.frames))
    found = f"{len(sample.frames)} frames intact, {sample.damaged} damaged"
    if share > MANY_SHARE:
        return Check("line", "to do", found, "try a shorter cable, another USB port, no hub")
    return Check("line", "ok" if share <= CLEAN_SHARE else "warning", found)


def check_rate(sample: Sample) -> Check:
    """Report frame rate, jitter, and the accuracy of the pad's clock."""
    if sample.ended_s - sample.frames[-1].host_s > STOPPED_S:
        return Check("rate", "to do", "the frames stopped during the check", "try another cable")
    pace = pace_of(sample.frames)
    wait_ms = 1000 * np.diff([frame.host_s for frame in sample.frames]).max()
    found = f"{pace.rate_hz:.1f} frames/s, jitter {pace.jitter_ms:.1f} ms, longest wait {wait_ms:.0f} ms"
    clock = relative_clock(sample.frames)
    if abs(clock - 1) > CLOCK_TOLERANCE:
        found += f"; its clock runs {clock:.2f} times as fast as this machine's"
        return Check("rate", "to do", found, SEND_A_CLOCK)
    if round(pace.rate_hz) < MIN_RATE_HZ:
        return Check("rate", "to do", f"{found}; {MIN_RATE_HZ:g} are needed", SCAN_FASTER)
    if round(pace.rate_hz) < SLOW_HZ:
        better = f"{SLOW_HZ:g} or more are better; below 20, fast gestures such as pats are often wrong"
        return Check("rate", "warning", f"{found}; {better}", SCAN_FASTER)
    if pace.lost > CLEAN_SHARE * len(sample.frames):
        return Check("rate", "warning", f"{found}; {pace.lost} frames lost on the way")
    if (gap_ms := steps_ms(sample.frames).max()) > MAX_GAP_MS:
        return Check("rate", "warning", f"{found}; gaps of up to {gap_ms} ms end touches", SEND_A_CLOCK)
    return Check("rate", "ok", found)
