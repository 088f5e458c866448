"""Makes the pictures of the live page and of the terminal view in the middle of the demo.

PYTHONPATH=.:tests python tests/by_hand/pictures.py docs/figures/live.png [--scheme light] [--visitors]
PYTHONPATH=.:tests python tests/by_hand/pictures.py --terminal docs/figures/demo.png [--size 100x30]
"""

import argparse
import io
import threading
import time
from collections.abc import Callable
from pathlib import Path

from matplotlib import font_manager
from PIL import Image, ImageDraw, ImageFont
from rich.console import Console
from rigs.browser import browser, picture, prefer, show_in
from rigs.live_rig import serving

from touchd.daemon.commands.demo import ACTIONS
from touchd.daemon.config import Settings
from touchd.daemon.events import (
    Event,
    LivePrediction,
    Prediction,
    RobotAction,
    RobotEvent,
    SensorEvent,
    TouchBegan,
    timestamp,
)
from touchd.daemon.pipeline import Clock, Pipeline
from touchd.daemon.playback.stream import DEMO_RECORDING
from touchd.daemon.setup.parts import load_model
from touchd.daemon.terminal.view import View
from touchd.drivers.frame import Frame
from touchd.drivers.recording import read_recordings, splice
from touchd.drivers.robot.reactions import Reactions, RobotMessage, spoken
from touchd.drivers.robot.session import RobotSettings

# The page goes grey when frames stop.
STILL_EVERY_S = 1 / 54
SETTLES_S = 5.0
WIDTH, HEIGHT, FONT_SIZE = 10, 20, 16
PAPER, INK = (12, 15, 19), (243, 245, 248)
# What a block character fills of its cell: left, top, right, bottom in pixels.
BLOCKS = {"▀": (0, 0, WIDTH, HEIGHT // 2), "▐": (WIDTH // 2, 0, WIDTH, HEIGHT)}
for number, (lower, left) in enumerate(zip("▁▂▃▄▅▆▇█", "▏▎▍▌▋▊▉█", strict=True), 1):
    BLOCKS[lower] = (0, HEIGHT - HEIGHT * number // 8, WIDTH, HEIGHT)
    BLOCKS[left] = (0, 0, WIDTH * number // 8, HEIGHT)
# The third touch, a rub, after its final answer.
TOUCH, AFTER_S = 3, 3.1


def play(
    settings: Settings,
    put: Callable[[Event], None],
    put_live: Callable[[LivePrediction], None],
    put_frame: Callable[[Frame], None],
) -> Frame:
    """Hand over all events and frames up to the moment, as fast as possible; returns its frame."""
    stream = splice(read_recordings(DEMO_RECORDING))
    reactions = Reactions(ACTIONS)
    began_ms: list[int] = []

    def emit(event: Event) -> None:
        put(event)
        if isinstance(event, TouchBegan) and event.touch == TOUCH:
            began_ms.append(event.sensor_ms)
        if not isinstance(event, Prediction):
            return
        answer = RobotMessage(event.gesture, event.confidence, 0.0, event.stage, event.touch, 0)
        reaction = reactions.choose(answer, time.monotonic(), is_told=event.told)
        for action in reaction.actions if reaction else ():
            if template := action.say or action.animated_say:
                words = spoken(template, event.gesture, event.confidence, settings.vocabulary)
                put(RobotAction(touch=event.touch, action="say", what=words, time=timestamp(time.time())))

    # A frame arrives at the sensor's time; real time is added after it, so that latencies are true.
    now_s = came_s = 0.0
    clock = Clock(monotonic_s=lambda: now_s + time.monotonic() - came_s)
    pipeline = Pipeline(settings.pipeline, load_model(settings), emit, clock, viewers=lambda: [put_live])
    for number, (sensor_ms, counts) in enumerate(zip(stream.sensor_ms.tolist(), stream.counts, strict=True)):
        now_s = sensor_ms / 1000
        frame = Frame(number, sensor_ms, now_s, counts)
        put_frame(frame)
        came_s = time.monotonic()
        pipeline.on_frame(frame)
        if began_ms and sensor_ms - began_ms[0] >= 1000 * AFTER_S:
            return frame
    raise RuntimeError(f"{DEMO_RECORDING} has no touch {TOUCH} of {AFTER_S} s")


def picture_page(path: Path, size: tuple[int, int], scheme: str, anchor: str) -> None:
    """Play the demo up to the moment on a live page in a browser, and save its picture."""
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
            while not over.wait(STILL_EVERY_S):
                page.put_frame(last, 0)

        threading.Thread(target=keep_still).start()
        time.sleep(SETTLES_S)
        picture(chrome, path)
        over.set()


def picture_terminal(path: Path, size: tuple[int, int]) -> None:
    """Play the demo up to the moment in a terminal view, and save its picture."""
    settings, (width, height) = Settings(), size
    console = Console(
        file=io.StringIO(), width=width, height=height, color_system="truecolor", force_terminal=True
    )
    marks = settings.scene.answer_at_frames
    view = View("the daemon at work", settings.vocabulary, marks, console)
    view.put(SensorEvent(state="up", time=""))
    view.put(RobotEvent(state="up", time=""))
    play(settings, view.put, view.put_live, lambda frame: view.show_frame(frame.pressure, frame.sensor_ms))
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
    parser.add_argument("--size", help="of the terminal in characters (100x30) or of the page (1366x768)")
    parser.add_argument("--scheme", choices=("dark", "light"), default="dark", help="of the page")
    parser.add_argument("--visitors", action="store_true", help="the page's view for visitors")
    options = parser.parse_args()
    width, height = map(int, (options.size or ("100x30" if options.terminal else "1366x768")).split("x"))
    if options.terminal:
        picture_terminal(options.out, (width, height))
    else:
        anchor = "#visitors" if options.visitors else ""
        picture_page(options.out, (width, height), options.scheme, anchor)


if __name__ == "__main__":
    main()
