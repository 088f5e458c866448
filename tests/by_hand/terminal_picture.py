"""Makes the picture of the terminal view in the middle of the demo.

PYTHONPATH=.:tests python tests/by_hand/terminal_picture.py docs/figures/demo.png [--size 100x30]
"""

import argparse
import io
from pathlib import Path

from by_hand.moment import play
from matplotlib import font_manager
from PIL import Image, ImageDraw, ImageFont
from rich.console import Console

from daemon.config import Settings
from daemon.events import RobotEvent, SensorEvent
from daemon.terminal.terms import term
from daemon.terminal.view import View

WIDTH, HEIGHT, FONT_SIZE = 10, 20, 16
PAPER, INK = (12, 15, 19), (243, 245, 248)
LOWER, LEFT = " ▁▂▃▄▅▆▇█", " ▏▎▍▌▋▊▉█"


def picture(console: Console, view: View, path: Path) -> None:
    """Save a view as PNG; block characters are drawn as rectangles without gaps, as a terminal shows them."""
    image = Image.new("RGB", (console.width * WIDTH, console.height * HEIGHT), PAPER)
    draw = ImageDraw.Draw(image)
    column = row = 0
    for text, style, _ in console.render(view):
        bold = bool(style and style.bold)
        ink = style.color.get_truecolor() if style and style.color else INK
        paper = style.bgcolor.get_truecolor() if style and style.bgcolor else PAPER
        for character in text:
            if character == "\n":
                column, row = 0, row + 1
                continue
            _draw(draw, character, (column * WIDTH, row * HEIGHT), tuple(ink), tuple(paper), bold)
            column += 1
    image.save(path)


def _draw(
    draw: ImageDraw.ImageDraw,
    character: str,
    at: tuple[int, int],
    ink: tuple[int, ...],
    paper: tuple[int, ...],
    bold: bool,
) -> None:
    x, y = at
    right, bottom = x + WIDTH - 1, y + HEIGHT - 1
    draw.rectangle((x, y, right, bottom), fill=paper)
    if character == "▀":
        draw.rectangle((x, y, right, y + HEIGHT // 2 - 1), fill=ink)
    elif character == "▐":
        draw.rectangle((x + WIDTH // 2, y, right, bottom), fill=ink)
    elif character in LOWER[1:]:
        draw.rectangle((x, bottom + 1 - HEIGHT * LOWER.index(character) // 8, right, bottom), fill=ink)
    elif character in LEFT[1:]:
        draw.rectangle((x, y, x + WIDTH * LEFT.index(character) // 8 - 1, bottom), fill=ink)
    else:
        draw.text(at, character, fill=ink, font=_font(bold))


def _font(bold: bool) -> ImageFont.FreeTypeFont:
    wanted = font_manager.FontProperties(family="DejaVu Sans Mono", weight="bold" if bold else "normal")
    return ImageFont.truetype(font_manager.findfont(wanted), FONT_SIZE)


def main() -> None:
    """Play the demo up to the moment and save it."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("out", type=Path)
    parser.add_argument("--size", default="100x30", help="of the terminal, COLUMNSxLINES")
    parser.add_argument("--language", choices=("en", "de"), default="en")
    options = parser.parse_args()
    width, height = map(int, options.size.split("x"))
    settings = Settings(language=options.language)
    console = Console(
        file=io.StringIO(), width=width, height=height, color_system="truecolor", force_terminal=True
    )
    view = View(
        "the daemon at work",
        settings.vocabulary,
        settings.scene.answer_at_frames,
        console,
        language=settings.language,
    )
    view.put(SensorEvent(state="up", time=""))
    view.put(RobotEvent(state="up", time=""))
    play(settings, view.put, view.put_live, lambda frame: view.show_frame(frame.pressure, frame.sensor_ms))
    view.doing(term(settings.language, "hand", name=settings.vocabulary["rub"].name))
    picture(console, view, options.out)


if __name__ == "__main__":
    main()
