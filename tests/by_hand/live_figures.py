"""Measures the live page's cost for the daemon, with none, one and many viewers.

PYTHONPATH=.:tests nice -n -5 python tests/by_hand/live_figures.py
"""

import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from typing import Any

import numpy as np
from rigs.sockets import free_port
from websockets.exceptions import WebSocketException
from websockets.sync.client import connect

from touchd.daemon.commands.bench import measure
from touchd.daemon.commands.run import SWITCH_S
from touchd.daemon.config import LiveSettings, Settings
from touchd.daemon.setup.parts import load_model, open_live_page
from touchd.drivers.frame import FRAME_RATE_HZ, Frame

TOUCH_S = 60.0
LOOP_S = 20.0
RETRY_S = 0.1
VIEWERS = (None, 0, 1, 16)


def watch(port: int) -> None:
    """View the page, and reconnect whenever the connection ends."""
    while True:
        with suppress(OSError, WebSocketException), connect(f"ws://127.0.0.1:{port}/stream") as viewer:
            for _ in viewer:
                pass
        time.sleep(RETRY_S)


@contextmanager
def watched(port: int, viewers: int) -> Iterator[None]:
    """Run viewers in another process."""
    with subprocess.Popen([sys.executable, __file__, str(port), str(viewers)]) as process:
        try:
            yield
        finally:
            process.kill()


def loop_cost_us(live: LiveSettings | None, seconds: float) -> list[float]:
    """Return the time that handing over a frame takes the daemon's loop, in microseconds: p50, p99."""
    settings = Settings(live=live)
    sink = open_live_page(settings, {"pad": load_model(settings)})
    if sink is None:
        return [0.0, 0.0]
    sink.start()
    counts = np.random.default_rng(0).integers(0, 300, (8, 8)).astype(np.uint16)
    took: list[float] = []
    for number in range(round(seconds * FRAME_RATE_HZ)):
        time.sleep(1 / FRAME_RATE_HZ)
        frame = Frame(number, 18 * number, 0.0, counts)
        began_s = time.perf_counter()
        sink.put_frame(frame, 0)
        took.append(1e6 * (time.perf_counter() - began_s))
    sink.stop(1.0)
    return np.percentile(took, [50, 99]).tolist()


def main() -> None:
    """Measure and print a table."""
    sys.setswitchinterval(SWITCH_S)
    sys.stdout.write("viewers  loop p50, p99 us  latency p50, p99 ms  CPU idle, touching %  memory MB\n")
    for viewers in VIEWERS:
        live = None if viewers is None else LiveSettings(port=free_port())
        with watched(live.port if live else 0, viewers or 0):
            p50_us, p99_us = loop_cost_us(live, LOOP_S)
            figures: Any = measure(TOUCH_S, live)
        cpu = f"{figures.cpu_idle_percent:.1f}, {figures.cpu_touching_percent:.1f}"
        latency = f"{figures.latency_p50_ms:.1f}, {figures.latency_p99_ms:.1f}"
        name = "no page" if viewers is None else viewers
        loop = f"{p50_us:.1f}, {p99_us:.1f}"
        sys.stdout.write(f"{name:<9}{loop:<18}{latency:<21}{cpu:<22}{figures.memory_mb:.0f}\n")


if __name__ == "__main__":
    if len(sys.argv) == 3:
        for _ in range(int(sys.argv[2])):
            threading.Thread(target=watch, args=(int(sys.argv[1]),), daemon=True).start()
        threading.Event().wait()
    else:
        main()
