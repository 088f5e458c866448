"""Makes the picture of the live page: `touchd demo --live` in a real browser, in the middle of a touch.

PYTHONPATH=. python tests/live_picture.py docs/figures/live.png [--scheme light] [--size 390x1300]
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from rigs.browser import browser, picture, prefer, show_in
from rigs.live_rig import free_port
from websockets.sync.client import connect

# The third touch: a rub, in between taken for scratching.
TOUCH = 3
AFTER_FINAL_S = 0.45
STARTS_WITHIN_S = 20.0


@contextmanager
def demo(port: int) -> Iterator[None]:
    """The demo, with its page at a port."""
    command = [sys.executable, "-m", "daemon", "demo", "--plain", "--live", str(port)]
    with subprocess.Popen(command, stdout=subprocess.DEVNULL) as process:
        try:
            yield
        finally:
            process.terminate()


def await_told(port: int, **wanted: object) -> None:
    """Return when the page is told something with these values."""
    until_s = time.monotonic() + STARTS_WITHIN_S
    while time.monotonic() < until_s:
        with suppress(ConnectionRefusedError), connect(f"ws://127.0.0.1:{port}/stream") as viewer:
            for message in viewer:
                told = json.loads(message) if isinstance(message, str) else {}
                if wanted.items() <= {key: told.get(key) for key in wanted}.items():
                    return
        time.sleep(0.1)
    raise RuntimeError(f"the page was not told {wanted}")


def main() -> None:
    """Run the demo until the picture can be taken."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("out", type=Path)
    parser.add_argument("--scheme", choices=("dark", "light"), default="dark")
    parser.add_argument("--size", default="1366x768", help="of the window, WIDTHxHEIGHT")
    options = parser.parse_args()
    width, height = map(int, options.size.split("x"))
    port = free_port()
    with browser() as chrome, demo(port):
        prefer(chrome, color_scheme=options.scheme)
        show_in(chrome, width, height)
        await_told(port, type="state")
        chrome.get(f"http://127.0.0.1:{port}/")
        await_told(port, touch=TOUCH, stage="final")
        time.sleep(AFTER_FINAL_S)
        picture(chrome, options.out)


if __name__ == "__main__":
    main()
