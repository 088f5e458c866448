"""Measures the live page's cost: for the daemon, with none, one and many viewers, and for a browser.

PYTHONPATH=.:tests nice -n -5 python tests/by_hand/live_figures.py
"""

import itertools
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from typing import Any

import numpy as np
from rigs.browser import browser
from rigs.live_rig import serving
from rigs.sockets import free_port
from selenium.webdriver import Chrome
from websockets.exceptions import WebSocketException
from websockets.sync.client import connect

from touchd.daemon.app.config import LiveSettings, Settings
from touchd.daemon.commands.bench import measure
from touchd.daemon.commands.one_pad import load_model
from touchd.daemon.commands.run import SWITCH_S
from touchd.daemon.live.server import open_live_page
from touchd.drivers.frame import FRAME_RATE_HZ, Frame
from touchd.model.studies.simulated import simulate

TOUCH_S = 30.0
DRAW_S = 10.0
LOOP_S = 20.0
RETRY_S = 0.1
VIEWERS = (None, 0, 1, 16)
COUNT_PICTURES = """
  window.drawn = 0;
  const put = CanvasRenderingContext2D.prototype.putImageData;
  CanvasRenderingContext2D.prototype.putImageData = function (...all) { drawn++; put.apply(this, all); };
"""


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
        frame = Frame(18 * number, 0.0, counts)
        began_s = time.perf_counter()
        sink.put_frame(frame, 0)
        took.append(1e6 * (time.perf_counter() - began_s))
    sink.stop(1.0)
    return np.percentile(took, [50, 99]).tolist()


def drawing(seconds: float) -> tuple[float, float]:
    """Return how many pictures of a rubbed pad a browser draws a second, and the milliseconds for one.

    The milliseconds are processor time of the page's main thread, so that other programs do not count.
    """
    stream = simulate([("rub", seconds + 5.0)], 1)[0].counts
    with browser() as chrome, serving() as served:
        chrome.execute_cdp_cmd("Performance.enable", {"timeDomain": "threadTicks"})
        chrome.get(f"http://127.0.0.1:{served.port}/")
        over = threading.Event()

        def play() -> None:
            for counts in itertools.cycle(stream):
                if over.wait(1 / FRAME_RATE_HZ):
                    return
                served.put_frame(counts)

        playing = threading.Thread(target=play)
        playing.start()
        time.sleep(2.0)
        chrome.execute_script(COUNT_PICTURES)
        began, busy_s = time.monotonic(), busy(chrome)
        time.sleep(seconds)
        pictures, took_s = chrome.execute_script("return drawn"), busy(chrome) - busy_s
        passed_s = time.monotonic() - began
        over.set()
        playing.join()
    return pictures / passed_s, 1000 * took_s / pictures


def busy(chrome: Chrome) -> float:
    """Return the seconds of processor time that the page's main thread has used."""
    metrics = chrome.execute_cdp_cmd("Performance.getMetrics", {})["metrics"]
    return float(next(one["value"] for one in metrics if one["name"] == "TaskDuration"))


def main() -> None:
    """Measure and print a table."""
    rate_hz, took_ms = drawing(DRAW_S)
    sys.stdout.write(f"a browser draws {rate_hz:.0f} pictures a second, in {took_ms:.1f} ms each\n")
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
