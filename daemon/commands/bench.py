"""`touchd bench`: latency, memory and processor time of the real daemon, on a fake pad at 54 Hz."""

import argparse
import os
import socket
import sys
import tempfile
import threading
import time
from collections.abc import Sequence
from contextlib import ExitStack
from itertools import cycle, islice
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from rich.console import Console

from touchd.daemon.app.config import SensorSettings, Settings
from touchd.daemon.commands.run import favour_latency
from touchd.daemon.path.events import Event, Prediction, epoch_s
from touchd.daemon.playback.rig import SpawnedDaemon, encoder_for
from touchd.daemon.playback.stream import DEMO_RECORDING
from touchd.drivers.errors import within
from touchd.drivers.fakes.fake_port import FakePort
from touchd.drivers.frame import FRAME_RATE_HZ
from touchd.drivers.recording import Stream, read_recordings, splice

QUIET_S, SETTLING_S = 20.0, 2.0
START_S = 30.0
# Events carry whole milliseconds, enough to find their frame: frames are 18 ms apart.
STAMP_S = 0.002
# An event read from the daemon, and when, by `time.monotonic` and by `time.time`.
Received = tuple[Event, float, float]
DESCRIPTION = "Measures the real daemon on a fake pad at 54 Hz."


def add_options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--seconds", type=within(float, 1.0, 86400.0), default=120.0, help="of touches (%(default)g)"
    )


def main(options: argparse.Namespace) -> int:
    """Measure and print; returns 0 whatever the figures are."""
    with Console(stderr=True).status(f"measuring for {QUIET_S + options.seconds:.0f} s"):
        figures = measure(options.seconds)
    for name, value in figures.items():
        sys.stdout.write(f"{name:<26}{value:10.2f}\n")
    return 0


def measure(touch_s: float) -> dict[str, float]:
    """Run the daemon on a pad that rests for 20 s and is then touched for `touch_s`; return the figures.

    A name ends in its unit. latency: from writing the last byte of the frame that completes an answer's
    window to reading the answer's line from the daemon's output. cpu: share of one core. memory: peak
    resident set.
    """
    received: list[Received] = []
    # As in the daemon: the pad's thread must not delay the one that reads the answers.
    favour_latency()
    with ExitStack() as closing:
        port = closing.enter_context(FakePort(touched(touch_s), encoder_for(SensorSettings())))
        folder = Path(closing.enter_context(tempfile.TemporaryDirectory(prefix="touchd-bench-")))
        log = closing.enter_context((folder / "log").open("wb"))
        ready = closing.enter_context(socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM))
        ready.bind(str(folder / "notify"))
        ready.settimeout(START_S)
        settings = Settings(sensor=SensorSettings(port=port.path))
        started_s = time.monotonic()
        daemon = SpawnedDaemon(settings, folder, log, {"NOTIFY_SOCKET": str(folder / "notify")})
        closing.callback(daemon.stop)

        def receive() -> None:
            received.extend((event, time.monotonic(), time.time()) for event in daemon.events())

        reader = threading.Thread(target=receive, name="touchd-bench", daemon=True)
        reader.start()
        while b"READY=1" not in ready.recv(4096):
            pass
        figures = {"start_to_ready_s": time.monotonic() - started_s}
        figures["cpu_idle_percent"] = _cpu_percent(daemon.process.pid, QUIET_S - SETTLING_S)
        time.sleep(SETTLING_S)
        figures["cpu_touching_percent"] = _cpu_percent(daemon.process.pid, touch_s)
        port.wait(START_S)
        figures["memory_mb"] = _peak_memory_mb(daemon.process.pid)
        daemon.stop()
        reader.join()
        latencies_ms = _latencies_ms(port.sent_s, received)
    percents = {f"latency_p{each}_ms": float(np.percentile(latencies_ms, each)) for each in (50, 99)}
    return {"answers": float(len(latencies_ms))} | percents | figures


def touched(touch_s: float) -> Stream:
    """Return a stream that rests for QUIET_S and then repeats the demo's touches for about `touch_s`."""
    rest, *others = read_recordings(DEMO_RECORDING)
    # A turn is a touch and the rest that follows it.
    turn_frames = len(others[0].counts) + len(others[1].counts)
    turns = max(1, round(touch_s * FRAME_RATE_HZ / turn_frames))
    rests = round(QUIET_S * FRAME_RATE_HZ / len(rest.counts))
    return splice([rest] * rests + list(islice(cycle(others), 2 * turns)))


def _latencies_ms(sent_s: NDArray[np.float64], received: Sequence[Received]) -> list[float]:
    """Return, for each answer, the time from writing the frame that made it due to reading its line.

    sent_s: (T,) when each frame was written. An event identifies its frame: it carries the time of its
    hand-over and the latency since that frame.
    """
    latencies_ms = []
    for event, read_s, read_epoch_s in received:
        if isinstance(event, Prediction):
            since_hand_over_s = read_epoch_s - epoch_s(event.time)
            frame_s = read_s - since_hand_over_s - event.latency_ms / 1000
            frame = int(np.searchsorted(sent_s, frame_s + STAMP_S)) - 1
            latencies_ms.append(1000 * (read_s - float(sent_s[frame])))
    return latencies_ms


def _cpu_percent(pid: int, seconds: float) -> float:
    """Return how much of one core the process takes over that many seconds, in per cent (see proc(5))."""

    def used_s() -> float:
        fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
        return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")

    began_s, before_s = time.monotonic(), used_s()
    time.sleep(seconds)
    return 100 * (used_s() - before_s) / (time.monotonic() - began_s)


def _peak_memory_mb(pid: int) -> float:
    status = Path(f"/proc/{pid}/status").read_text()
    return int(status.partition("VmHWM:")[2].split()[0]) * 1024 / 1e6
