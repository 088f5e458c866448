"""Films a live page that a mouse touches in a real browser: an animation, or its middle picture as PNG.

PYTHONPATH=.:tests python tests/by_hand/pictures.py docs/figures/touched.webp
PYTHONPATH=.:tests python tests/by_hand/pictures.py docs/figures/live.png
"""

import io
import math
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace

from numpy.random import RandomState
from PIL import Image, ImageDraw
from rigs.browser import browser, prefer, show_in
from selenium.webdriver import Chrome

from touchd.daemon.app.config import LiveSettings, Settings
from touchd.daemon.commands.demo import ACTIONS
from touchd.daemon.commands.settings import load_model
from touchd.daemon.live import server, touch
from touchd.daemon.live.address import listen
from touchd.daemon.live.memory import Scene
from touchd.daemon.live.server import LiveServer
from touchd.daemon.live.touch import Touching
from touchd.daemon.path.events import Event, Prediction, RobotAction, RobotEvent, SensorEvent, timestamp
from touchd.daemon.path.pipeline import Clock, Pipeline
from touchd.daemon.robot.reactions import Choice, spoken
from touchd.daemon.robot.words import words_of
from touchd.drivers.fakes.fabric import Fabric
from touchd.drivers.fakes.pointers import PressingHands
from touchd.drivers.frame import DEFAULT_PAD, FRAME_RATE_HZ, Frame
from touchd.drivers.robot.session import RobotSettings

INK = (243, 245, 248)
FILM_SIZE, PICTURE_SIZE = (800, 600), (1366, 768)
# The animation: length, frames per mouse move and per picture, quality, seed.
FILM_S, FRAMES_A_MOVE, FRAMES_A_PICTURE, FILM_QUALITY, FILM_SEED = 11.5, 2, 6, 60, 2
# The page's clock follows the pad's.
STEPPED_CLOCK = "window.padMs = 0; performance.now = () => window.padMs;"
# Set the page's clock, and wait until everything received so far is drawn.
STEP = """
  const [ms, done] = arguments;
  window.padMs = ms;
  setTimeout(() => requestAnimationFrame(() => requestAnimationFrame(() => done())), 60);
"""
SQUARE = "return document.querySelector('.square').getBoundingClientRect().toJSON()"


class Played:
    """A pipeline in the pad's own time, and what the robot says to its answers, on a page."""

    def __init__(self, settings: Settings, page: LiveServer) -> None:
        self._page = page
        self._reactions = Choice(ACTIONS)
        self._vocabulary = words_of(settings)
        # A frame arrives at the sensor's time; real time is added after it, so that latencies are true.
        self._now_s = self._came_s = 0.0
        clock = Clock(monotonic_s=lambda: self._now_s + time.monotonic() - self._came_s)
        model = load_model(settings)
        self._pipeline = Pipeline(settings.pipeline, model, self._emit, clock, viewers=lambda: [page.put])

    def on_frame(self, frame: Frame) -> None:
        self._page.put_frame(frame, 0)
        self._now_s, self._came_s = frame.host_s, time.monotonic()
        self._pipeline.on_frame(frame)

    def _emit(self, event: Event) -> None:
        self._page.put(event)
        if not isinstance(event, Prediction):
            return
        for action in self._reactions.actions(event, time.monotonic()):
            if template := action.say or action.animated_say:
                words = spoken(template, event.gesture, event.confidence, self._vocabulary)
                now = timestamp(time.time())
                self._page.put(RobotAction(touch=event.touch, action="say", what=words, time=now))


def hand_at(time_s: float) -> tuple[float, float] | None:
    """Return where the mouse presses, across and down from 0 to 1: it strokes, and then it pats."""
    stroking_s, patting_s = time_s - 1.0, time_s - 7.5
    if 0.0 <= stroking_s < 4.0 and stroking_s % 1.4 < 0.9:
        return 0.08 + 0.93 * (stroking_s % 1.4), 0.45 + 0.05 * math.sin(3.0 * stroking_s)
    if 0.0 <= patting_s < 2.2 and patting_s % 0.44 < 0.14:
        return 0.55, 0.5
    return None


class Mouse:
    """A real browser's mouse on the page's pad."""

    def __init__(self, chrome: Chrome) -> None:
        self._chrome = chrome
        self._square = chrome.execute_script(SQUARE)
        self.at: tuple[float, float] | None = None

    def press(self, place: tuple[float, float] | None) -> None:
        """Press or move to a place, across and down from 0 to 1; release for None."""
        if place is None:
            if self.at is not None:
                self._send("mouseReleased", self.at)
            self.at = None
            return
        square = self._square
        at = square["x"] + square["width"] * place[0], square["y"] + square["height"] * place[1]
        self._send("mouseMoved" if self.at else "mousePressed", at)
        self.at = at

    def _send(self, kind: str, at: tuple[float, float]) -> None:
        event = {"type": kind, "button": "left", "buttons": 1, "clickCount": 1, "x": at[0], "y": at[1]}
        self._chrome.execute_cdp_cmd("Input.dispatchMouseEvent", event)


def filmed(
    chrome: Chrome, played: Played, touching: Touching, clock: SimpleNamespace
) -> Iterator[Image.Image]:
    """Yield pictures of a page that is touched. A picture's time is the pad's, however long it takes."""
    rng = RandomState(FILM_SEED)
    fabric, hands, mouse, number = Fabric(rng), PressingHands(rng), Mouse(chrome), 0
    while number < FILM_S * FRAME_RATE_HZ:
        mouse.press(hand_at(number / FRAME_RATE_HZ))
        chrome.execute_async_script(STEP, 1000 * number / FRAME_RATE_HZ)
        for _ in range(FRAMES_A_MOVE):
            sensor_ms = round(1000 * number / FRAME_RATE_HZ)
            counts = fabric.read(hands.frame(touching.pointers()))
            played.on_frame(Frame(sensor_ms, sensor_ms / 1000, counts))
            number += 1
            clock.frames = number
        if number % FRAMES_A_PICTURE == 0:
            chrome.execute_async_script(STEP, 1000 * number / FRAME_RATE_HZ)
            shown = Image.open(io.BytesIO(chrome.get_screenshot_as_png())).convert("RGB")
            if mouse.at is not None:
                x, y = mouse.at
                ImageDraw.Draw(shown).ellipse((x - 11, y - 11, x + 11, y + 11), outline=INK, width=3)
            yield shown


def main() -> None:
    """Make the animation or the picture."""
    out = Path(sys.argv[1])
    is_film = out.suffix == ".webp"
    settings, touching = Settings(robot=RobotSettings(url="tcp://127.0.0.1:9559")), Touching()
    clock = SimpleNamespace(frames=0)
    clock.monotonic = lambda: clock.frames / FRAME_RATE_HZ + 1e-6 * time.monotonic()
    server.time, touch.LIFTED_AFTER_S = clock, math.inf
    with browser() as chrome, listen(LiveSettings(port=0)) as listening:
        scene = Scene(settings, load_model(settings))
        page = LiveServer(listening, LiveSettings(), {DEFAULT_PAD: scene}, touching)
        page.start()
        prefer(chrome, color_scheme="dark")
        show_in(chrome, *(FILM_SIZE if is_film else PICTURE_SIZE))
        chrome.execute_cdp_cmd("Page.addScriptToEvaluateOnNewDocument", {"source": STEPPED_CLOCK})
        chrome.get(f"http://127.0.0.1:{listening.getsockname()[1]}/")
        for event in (SensorEvent, RobotEvent):
            page.put(event(state="up", time=timestamp(time.time())))
        first, *others = filmed(chrome, Played(settings, page), touching, clock)
        page.stop(1.0)
    if is_film:
        pause_ms = round(1000 * FRAMES_A_PICTURE / FRAME_RATE_HZ)
        film = {"save_all": True, "append_images": others, "duration": pause_ms, "loop": 0, "method": 4}
        first.save(out, quality=FILM_QUALITY, **film)
    else:
        others[len(others) // 2].save(out)


if __name__ == "__main__":
    main()
