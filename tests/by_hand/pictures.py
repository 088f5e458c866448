"""Makes the pictures of the live page and of the terminal view, and an animation of a page that is touched.

PYTHONPATH=.:tests python tests/by_hand/pictures.py docs/figures/live.png [--scheme light] [--visitors]
PYTHONPATH=.:tests python tests/by_hand/pictures.py --terminal docs/figures/demo.png [--size 100x30]
PYTHONPATH=.:tests python tests/by_hand/pictures.py --touched docs/figures/touched.webp
"""

import argparse
import io
import itertools
import math
import threading
import time
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace

from matplotlib import font_manager
from numpy.random import RandomState
from PIL import Image, ImageDraw, ImageFont
from rich.console import Console
from rigs.browser import browser, picture, prefer, show_in
from rigs.live_rig import serving

from touchd.daemon.app.config import LiveSettings, Settings
from touchd.daemon.commands.demo import ACTIONS
from touchd.daemon.commands.one_pad import load_model
from touchd.daemon.live import server, touch
from touchd.daemon.live.address import listen
from touchd.daemon.live.memory import Scene
from touchd.daemon.live.server import LiveServer
from touchd.daemon.live.touch import Touching
from touchd.daemon.path.events import (
    Event,
    LivePrediction,
    Prediction,
    RobotAction,
    RobotEvent,
    SensorEvent,
    TouchBegan,
    timestamp,
)
from touchd.daemon.path.pipeline import Clock, Pipeline
from touchd.daemon.playback.stream import DEMO_RECORDING
from touchd.daemon.robot.reactions import Choice, spoken
from touchd.daemon.robot.words import words_of
from touchd.daemon.view.view import View
from touchd.drivers.fakes.fabric import Fabric
from touchd.drivers.fakes.pointers import PressingHands
from touchd.drivers.frame import DEFAULT_PAD, FRAME_RATE_HZ, Frame
from touchd.drivers.recording import read_recordings, splice
from touchd.drivers.robot.session import RobotSettings

# The page goes grey when frames stop.
STILL_EVERY_S = 1 / 54
SETTLES_S = 5.0
WIDTH, HEIGHT, FONT_SIZE = 10, 20, 16
PAPER, INK = (12, 15, 19), (243, 245, 248)
# The part of its cell that a block character fills: left, top, right, bottom in pixels.
BLOCKS = {"▀": (0, 0, WIDTH, HEIGHT // 2), "▐": (WIDTH // 2, 0, WIDTH, HEIGHT)}
for number, (lower, left) in enumerate(zip("▁▂▃▄▅▆▇█", "▏▎▍▌▋▊▉█", strict=True), 1):
    BLOCKS[lower] = (0, HEIGHT - HEIGHT * number // 8, WIDTH, HEIGHT)
    BLOCKS[left] = (0, 0, WIDTH * number // 8, HEIGHT)
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
# The third touch, a rub, after its final answer.
TOUCH, AFTER_S = 3, 3.1


class Played:
    """A pipeline in the pad's own time, and what the robot says to its answers.

    began_ms: the pad's clock at which each touch began.
    """

    def __init__(
        self, settings: Settings, put: Callable[[Event], None], put_live: Callable[[LivePrediction], None]
    ) -> None:
        self._put = put
        self._reactions = Choice(ACTIONS)
        self._vocabulary = words_of(settings)
        self.began_ms: dict[int, int] = {}
        # A frame arrives at the sensor's time; real time is added after it, so that latencies are true.
        self._now_s = self._came_s = 0.0
        clock = Clock(monotonic_s=lambda: self._now_s + time.monotonic() - self._came_s)
        self._pipeline = Pipeline(
            settings.pipeline, load_model(settings), self._emit, clock, viewers=lambda: [put_live]
        )

    def on_frame(self, frame: Frame) -> None:
        self._now_s, self._came_s = frame.host_s, time.monotonic()
        self._pipeline.on_frame(frame)

    def _emit(self, event: Event) -> None:
        self._put(event)
        if isinstance(event, TouchBegan):
            self.began_ms[event.touch] = event.sensor_ms
        if not isinstance(event, Prediction):
            return
        for action in self._reactions.actions(event, time.monotonic()):
            if template := action.say or action.animated_say:
                words = spoken(template, event.gesture, event.confidence, self._vocabulary)
                self._put(
                    RobotAction(touch=event.touch, action="say", what=words, time=timestamp(time.time()))
                )


def play(
    settings: Settings,
    put: Callable[[Event], None],
    put_live: Callable[[LivePrediction], None],
    put_frame: Callable[[Frame], None],
) -> Frame:
    """Hand over all events and frames up to the pictured moment, without waiting; return the last frame."""
    stream = splice(read_recordings(DEMO_RECORDING))
    played = Played(settings, put, put_live)
    for sensor_ms, counts in zip(stream.sensor_ms.tolist(), stream.counts, strict=True):
        frame = Frame(sensor_ms, sensor_ms / 1000, counts)
        put_frame(frame)
        played.on_frame(frame)
        if sensor_ms - played.began_ms.get(TOUCH, sensor_ms) >= 1000 * AFTER_S:
            return frame
    raise RuntimeError(f"{DEMO_RECORDING} has no touch {TOUCH} of {AFTER_S} s")


def hand_at(time_s: float) -> tuple[float, float] | None:
    """Return where the mouse presses, across and down from 0 to 1: it strokes, and then it pats."""
    stroking_s, patting_s = time_s - 1.0, time_s - 7.5
    if 0.0 <= stroking_s < 4.0 and stroking_s % 1.4 < 0.9:
        return 0.08 + 0.93 * (stroking_s % 1.4), 0.45 + 0.05 * math.sin(3.0 * stroking_s)
    if 0.0 <= patting_s < 2.2 and patting_s % 0.44 < 0.14:
        return 0.55, 0.5
    return None


def film_page(path: Path, size: tuple[int, int], scheme: str) -> None:
    """Touch the page of a simulated pad with a real browser's mouse; save an animation of it.

    A picture's time is the pad's, not this machine's, however long the picture takes.
    """
    rng = RandomState(FILM_SEED)
    fabric, hands, touching = Fabric(rng), PressingHands(rng), Touching()
    settings = Settings(robot=RobotSettings(url="tcp://127.0.0.1:9559"))
    clock = SimpleNamespace(monotonic=lambda: number / FRAME_RATE_HZ + 1e-6 * time.monotonic())
    number = 0
    pictures: list[Image.Image] = []
    with browser() as chrome, listen(LiveSettings(port=0)) as listening:
        server.time, touch.LIFTED_AFTER_S = clock, math.inf
        scene = Scene(settings, load_model(settings))
        page = LiveServer(listening, LiveSettings(), {DEFAULT_PAD: scene}, touching)
        page.start()
        played = Played(settings, page.put, page.put)
        prefer(chrome, color_scheme=scheme)
        show_in(chrome, *size)
        chrome.execute_cdp_cmd("Page.addScriptToEvaluateOnNewDocument", {"source": STEPPED_CLOCK})
        chrome.get(f"http://127.0.0.1:{listening.getsockname()[1]}/")
        page.put(SensorEvent(state="up", time=timestamp(time.time())))
        page.put(RobotEvent(state="up", time=timestamp(time.time())))
        square = chrome.execute_script(
            "return document.querySelector('.square').getBoundingClientRect().toJSON()"
        )

        def pixels(place: tuple[float, float]) -> tuple[float, float]:
            return tuple(
                square[side] + square[length] * at
                for side, length, at in zip("xy", ("width", "height"), place, strict=True)
            )

        def use_mouse(kind: str, at: tuple[float, float]) -> None:
            event = {"type": kind, "button": "left", "buttons": 1, "clickCount": 1, "x": at[0], "y": at[1]}
            chrome.execute_cdp_cmd("Input.dispatchMouseEvent", event)

        at: tuple[float, float] | None = None
        while number < FILM_S * FRAME_RATE_HZ:
            place = hand_at(number / FRAME_RATE_HZ)
            if place is None and at is not None:
                use_mouse("mouseReleased", at)
            if place is not None:
                use_mouse("mouseMoved" if at else "mousePressed", pixels(place))
            at = None if place is None else pixels(place)
            chrome.execute_async_script(STEP, 1000 * number / FRAME_RATE_HZ)
            for _ in range(FRAMES_A_MOVE):
                sensor_ms = round(1000 * number / FRAME_RATE_HZ)
                counts = fabric.read(hands.frame(touching.pointers()))
                frame = Frame(sensor_ms, sensor_ms / 1000, counts)
                page.put_frame(frame, 0)
                played.on_frame(frame)
                number += 1
            if number % FRAMES_A_PICTURE == 0:
                chrome.execute_async_script(STEP, 1000 * number / FRAME_RATE_HZ)
                shown = Image.open(io.BytesIO(chrome.get_screenshot_as_png())).convert("RGB")
                if at is not None:
                    ring = ImageDraw.Draw(shown)
                    ring.ellipse((at[0] - 11, at[1] - 11, at[0] + 11, at[1] + 11), outline=INK, width=3)
                pictures.append(shown)
        page.stop(1.0)
    pictures[0].save(
        path,
        save_all=True,
        append_images=pictures[1:],
        duration=round(1000 * FRAMES_A_PICTURE / FRAME_RATE_HZ),
        loop=0,
        quality=FILM_QUALITY,
        method=4,
    )


def picture_page(path: Path, size: tuple[int, int], scheme: str, anchor: str) -> None:
    """Play the demo up to the pictured moment on a live page in a browser, and save a picture."""
    robot = RobotSettings(url="tcp://127.0.0.1:9559")
    over = threading.Event()
    with browser() as chrome, serving(robot=robot) as served:
        prefer(chrome, color_scheme=scheme)
        show_in(chrome, *size)
        chrome.get(f"http://127.0.0.1:{served.port}/{anchor}")
        page = served.sink
        page.put(SensorEvent(state="up", time=timestamp(time.time())))
        page.put(RobotEvent(state="up", time=timestamp(time.time())))

        def pace(frame: Frame) -> None:
            page.put_frame(frame, 0)
            time.sleep(0.002)

        last = play(served.settings, page.put, page.put, pace)

        def keep_still() -> None:
            begun_s = time.monotonic()
            for number in itertools.count():
                if over.wait(max(0.0, begun_s + STILL_EVERY_S * number - time.monotonic())):
                    return
                page.put_frame(last, 0)

        threading.Thread(target=keep_still).start()
        time.sleep(SETTLES_S)
        picture(chrome, path)
        over.set()


def picture_terminal(path: Path, size: tuple[int, int]) -> None:
    """Play the demo up to the pictured moment in a terminal view, and save a picture."""
    settings, (width, height) = Settings(), size
    console = Console(
        file=io.StringIO(), width=width, height=height, color_system="truecolor", force_terminal=True
    )
    marks = settings.scene.answer_at_frames
    view = View("the daemon at work", words_of(settings), marks, console)
    view.put(SensorEvent(state="up", time=""))
    view.put(RobotEvent(state="up", time=""))
    play(settings, view.put, view.put, lambda frame: view.show_frame(frame.pressure, frame.sensor_ms))
    view.doing("the simulated hand: rub")
    draw(console, view, path)


def draw(console: Console, view: View, path: Path) -> None:
    """Save a view as PNG; block characters are drawn as rectangles without gaps, as a terminal shows them."""
    image = Image.new("RGB", (console.width * WIDTH, console.height * HEIGHT), PAPER)
    draw = ImageDraw.Draw(image)
    x = y = 0
    for text, style, _ in console.render(view):
        font = _font(bool(style and style.bold))
        ink = style.color.get_truecolor() if style and style.color else INK
        paper = style.bgcolor.get_truecolor() if style and style.bgcolor else PAPER
        for character in text:
            if character == "\n":
                x, y = 0, y + HEIGHT
                continue
            draw.rectangle((x, y, x + WIDTH - 1, y + HEIGHT - 1), fill=tuple(paper))
            if character in BLOCKS:
                left, top, right, bottom = BLOCKS[character]
                draw.rectangle((x + left, y + top, x + right - 1, y + bottom - 1), fill=tuple(ink))
            else:
                draw.text((x, y), character, fill=tuple(ink), font=font)
            x += WIDTH
    image.save(path)


def _font(bold: bool) -> ImageFont.FreeTypeFont:
    wanted = font_manager.FontProperties(family="DejaVu Sans Mono", weight="bold" if bold else "normal")
    return ImageFont.truetype(font_manager.findfont(wanted), FONT_SIZE)


def main() -> None:
    """Make the picture."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("out", type=Path)
    parser.add_argument("--terminal", action="store_true", help="of the terminal view; else of the live page")
    parser.add_argument("--touched", action="store_true", help="an animation of a page that is touched")
    parser.add_argument("--size", help="of the terminal in characters (100x30) or of the page (1366x768)")
    parser.add_argument("--scheme", choices=("dark", "light"), default="dark", help="of the page")
    parser.add_argument("--visitors", action="store_true", help="the page's view for visitors")
    options = parser.parse_args()
    usual = "100x30" if options.terminal else "800x600" if options.touched else "1366x768"
    width, height = map(int, (options.size or usual).split("x"))
    if options.terminal:
        picture_terminal(options.out, (width, height))
    elif options.touched:
        film_page(options.out, (width, height), options.scheme)
    else:
        anchor = "#visitors" if options.visitors else ""
        picture_page(options.out, (width, height), options.scheme, anchor)


if __name__ == "__main__":
    main()
