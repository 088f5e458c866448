"""Makes the live page's picture in the middle of the demo, with a real browser.

PYTHONPATH=.:tests python tests/by_hand/live_picture.py docs/figures/live.png [--scheme light] [--visitors]
"""

import argparse
import threading
import time
from pathlib import Path

from by_hand.moment import play
from rigs.browser import browser, picture, prefer, show_in
from rigs.live_rig import serving

from daemon.events import RobotEvent, SensorEvent, timestamp
from drivers.frame import Frame
from drivers.robot.settings import RobotSettings

# The page goes grey when frames stop.
STILL_EVERY_S = 1 / 54
SETTLES_S = 5.0


def main() -> None:
    """Play the demo up to the moment and save the page's picture."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("out", type=Path)
    parser.add_argument("--scheme", choices=("dark", "light"), default="dark")
    parser.add_argument("--size", default="1366x768", help="of the window, WIDTHxHEIGHT")
    parser.add_argument("--language", choices=("en", "de"), default="en")
    parser.add_argument("--visitors", action="store_true", help="the visitors' view")
    options = parser.parse_args()
    width, height = map(int, options.size.split("x"))
    robot = RobotSettings(url="tcp://127.0.0.1:9559")
    over = threading.Event()
    with browser() as chrome, serving(language=options.language, robot=robot) as served:
        prefer(chrome, color_scheme=options.scheme)
        show_in(chrome, width, height)
        chrome.get(f"http://127.0.0.1:{served.port}/{'#visitors' if options.visitors else ''}")
        page = served.sink
        page.put(SensorEvent(state="up", time=timestamp(time.time())))
        page.put(RobotEvent(state="up", time=timestamp(time.time())))

        def pace(frame: Frame) -> None:
            page.put_frame(frame, 0)
            time.sleep(0.002)

        last = play(served.settings, page.put, page.put, pace)

        def keep_still() -> None:
            while not over.wait(STILL_EVERY_S):
                page.put_frame(last, 0)

        threading.Thread(target=keep_still).start()
        time.sleep(SETTLES_S)
        picture(chrome, options.out)
        over.set()


if __name__ == "__main__":
    main()
