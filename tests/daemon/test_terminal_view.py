"""The terminal view: its content fits at every size and number of colours."""

import io
import os
import pty
import re
import select
import signal
import struct
import subprocess
import sys
from fcntl import ioctl
from termios import TIOCSWINSZ
from typing import Any

import msgspec
import numpy as np
import pyte
import pytest
from rich.cells import cell_len
from rich.console import Console
from rigs.made_events import PREDICTION
from rigs.wait import WITHIN_S

from touchd.daemon.app.config import Language, Settings
from touchd.daemon.path.events import Prediction, RobotAction, RobotEvent, SensorEvent, TouchBegan, TouchEnded
from touchd.daemon.robot.words import name_of, words_of
from touchd.daemon.sinks.labels import Labeller, keys_of
from touchd.daemon.view.elements import big
from touchd.daemon.view.terminal import listening
from touchd.daemon.view.view import View
from touchd.drivers.frame import CLOCK_MODULUS, DEFAULT_PAD, Frame

SIZES = [(10, 5), (1, 1), (60, 24), (80, 24), (100, 30), (120, 40), (200, 60), (40, 16), (30, 8)]


# Shows a view until its input ends.
SHOWN = """
import sys
from touchd.daemon.app.config import Settings
from touchd.daemon.path.events import SensorEvent
from touchd.daemon.view.view import View
with View("a title", Settings()) as view:
    view.put(SensorEvent(state="up", time=""))
    sys.stdin.read()
print("gone")
"""


def prediction(stage: str, frames: int, gesture: str) -> Prediction:
    shares = dict.fromkeys(("constant", "rub", "scratch", "tickle"), 0.01)
    own: dict[str, Any] = {"stage": stage, "frames": frames, "gesture": gesture, "elapsed_s": frames / 54}
    return msgspec.structs.replace(
        PREDICTION, **own, probabilities={**shares, "notouch": 0.0, "pat": 0.15, "stroke": 0.81}
    )


def view_of(
    width: int, height: int, colours: str | None = None, language: Language = "en"
) -> tuple[View, Console]:
    colour: dict[str, Any] = {"color_system": colours, "force_terminal": colours is not None}
    console = Console(file=io.StringIO(), width=width, height=height, **colour)
    view = View("http://127.0.0.1:8054/", Settings(language=language), console=console)
    return view, console


def touch(view: View) -> None:
    view.put(SensorEvent(state="up", time="", reason="x" * 200))
    view.put(RobotEvent(state="up", time=""))
    # The pad's clock wraps in the touch.
    view.put_frame(Frame(CLOCK_MODULUS - 100, 0.0, np.zeros((8, 8), np.uint16)))
    view.put(TouchBegan(touch=7, time="", sensor_ms=CLOCK_MODULUS - 100))
    for number in range(1, 160):
        clock_ms = (18 * number - 100) % CLOCK_MODULUS
        view.put_frame(Frame(clock_ms, 0.0, np.full((8, 8), 90, np.uint16)))
    view.put(prediction("early", 54, "pat"))
    view.put(prediction("final", 144, "stroke"))
    view.put(RobotAction(touch=7, action="say", what="Oh, it is\na stroke!", time=""))
    view.put(RobotAction(touch=7, action="leds", what="green", time=""))


def screen(view: View, console: Console) -> list[str]:
    file = io.StringIO()
    console.file = file
    console.print(view, end="", soft_wrap=True)
    return re.sub(r"\x1b\[[0-9;]*m", "", file.getvalue()).split("\n")


@pytest.mark.parametrize("colours", ["truecolor", "256", "standard", None])
@pytest.mark.parametrize("size", SIZES)
def test_the_view_fills_the_terminal_exactly(size: tuple[int, int], colours: str | None) -> None:
    view, console = view_of(*size, colours)
    for _ in range(2):
        lines = screen(view, console)
        assert [cell_len(line) for line in lines] == [size[0]] * size[1]
        touch(view)


def test_only_the_frames_of_the_shown_pad_are_shown() -> None:
    view, console = view_of(80, 24)

    def after_a_frame(counts: int, pad: str) -> list[str]:
        view.put_frame(Frame(0, 0.0, np.full((8, 8), counts, np.uint16)), 0, pad)
        return screen(view, console)

    at_rest = after_a_frame(0, DEFAULT_PAD)
    assert after_a_frame(90, "arm") == at_rest
    assert after_a_frame(90, DEFAULT_PAD) != at_rest


@pytest.mark.parametrize("size", [(60, 24), (80, 24), (120, 40)])
def test_nothing_is_lost_at_the_usual_sizes(size: tuple[int, int]) -> None:
    view, console = view_of(*size)
    touch(view)
    shown = "\n".join(screen(view, console))
    texts = """http://127.0.0.1:8054/, pad up, robot up, Touch 7 · 2.9 s, 81% sure, after 2.67 s,
      ↻ was pat · told after 2.67 s, pat 81% ✓, ↻ stroke 81% ✓, still hand, tickle,
      “Oh, it is a stroke!”, Last touches"""
    for text in re.split(r",\s+", texts):
        assert text in shown, text


def test_only_a_told_answer_was_there_before() -> None:
    view, console = view_of(80, 24)
    view.put(TouchBegan(touch=7, time="", sensor_ms=0))
    view.put(msgspec.structs.replace(PREDICTION, gesture="rub", told=False))
    view.put(msgspec.structs.replace(PREDICTION, stage="final", gesture="stroke"))
    view.put(TouchEnded(touch=7, gesture="stroke", frames=170, reason="released", time=""))
    assert "↻" not in "\n".join(screen(view, console))


def test_labels_of_marks_never_run_together() -> None:
    for width, labels in ((80, "1 s 1.5 s 2.67 s"), (60, "1 s 2.67 s")):
        view, console = view_of(width, 24)
        touch(view)
        (shown,) = (line for line in screen(view, console) if re.search(r" 1 s .* 2\.67 s *$", line))
        assert shown.split()[-len(labels.split()) :] == labels.split()


def test_without_colours_the_pad_is_drawn_in_characters(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("NO_COLOR", "1")
    view, console = view_of(80, 24, "truecolor")
    touch(view)
    shown = "\n".join(line[:33] for line in screen(view, console))
    assert "#" in shown
    assert "▀" not in shown


def test_old_bars_disappear_after_a_touch() -> None:
    view, console = view_of(80, 24)
    touch(view)
    assert any(re.search(r"stroke +█.* 81% *$", line) for line in screen(view, console))
    view.put(TouchEnded(touch=7, gesture="stroke", frames=170, reason="released", time=""))
    lines = screen(view, console)
    assert any(re.search(r"stroke +─+ +- *$", line) for line in lines)
    assert any("stroke 3.1 s" in line for line in lines)


def test_a_word_is_large_where_it_fits_and_never_cut() -> None:
    assert [len(line) for line in big("rub", 40)] == [22, 22, 22]
    assert [len(line) for line in big("rub", 20)] == [11, 11, 11]
    assert len({len(line) for line in big("Tätscheln", 60)}) == 1
    assert big("scratch", 20) == ["scratch"]
    assert big("pat🤚", 60) == ["pat🤚"]


@pytest.mark.parametrize(
    "gestures",
    [["hug", "pat"], [f"a-gesture-with-a-long-name-{i}" for i in range(12)], ["叩く", "ぽんぽんと\n叩く"]],
)
def test_the_view_has_room_for_any_gestures(gestures: list[str]) -> None:
    view, console = view_of(80, 24)
    shares = {gesture: 1.0 / 2.0 ** (len(gestures) - i) for i, gesture in enumerate(gestures)}
    view.put(TouchBegan(touch=7, time="", sensor_ms=0))
    view.put(msgspec.structs.replace(PREDICTION, gesture=gestures[-1], confidence=0.5, probabilities=shares))
    lines = screen(view, console)
    assert [cell_len(line) for line in lines] == [80] * 24
    name = gestures[-1][:12].replace("\n", " ")
    assert any(re.search(rf"{name}\S* +█+.?─* +50% *$", line) for line in lines)


@pytest.mark.parametrize("language", ["en", "de"])
@pytest.mark.parametrize("size", [(80, 24), (60, 18), (120, 40)])
def test_every_key_that_labels_a_touch_is_shown(size: tuple[int, int], language: Language) -> None:
    view, console = view_of(*size, language=language)
    gestures = ("constant", "notouch", "pat", "rub", "scratch", "stroke", "tickle")
    view.labeller = Labeller(view.put, {"pad": gestures}, are_saved=True)
    view.on_key("1")
    assert len(screen(view, console)) == size[1]
    touch(view)
    view.on_key("4")
    shown = screen(view, console)
    assert len(shown) == size[1]
    keys = " ".join(shown)
    for key, gesture in keys_of(gestures).items():
        assert f"{key} {name_of(words_of(Settings(language=language)), gesture)} " in keys
    assert "touch 7 was: " in shown[-1]


@pytest.mark.parametrize("doing", ["", "the simulated hand: pat"])
def test_a_command_to_copy_is_shown_whole(doing: str) -> None:
    view, console = view_of(80, 24)
    view.doing(doing)
    command = "/opt/touchd/bin/touchd train --keep-all --extra /var/lib/touchd/events.jsonl.touches"
    view.note(f"10 touches labelled; to learn from them: {command}")
    shown = screen(view, console)
    assert [len(line) for line in shown] == [80] * 24
    last = " ".join(" ".join(shown[-3:]).split())
    assert last.endswith(command)
    assert doing in last


def read_until(terminal: int, text: bytes, times: int = 1) -> bytes:
    """Read what is drawn until a text has come so often."""
    drawn = b""
    while drawn.count(text) < times:
        assert select.select([terminal], [], [], WITHIN_S)[0], drawn
        drawn += os.read(terminal, 65536)
    return drawn


def test_resizing_ctrl_z_and_ending_leave_the_terminal_clean() -> None:
    master, slave = pty.openpty()
    screen = pyte.Screen(80, 24)
    stream = pyte.ByteStream(screen)

    def resize(width: int, height: int) -> None:
        ioctl(slave, TIOCSWINSZ, struct.pack("4H", height, width, 0, 0))
        screen.resize(height, width)

    resize(80, 24)
    environment = {name: value for name, value in os.environ.items() if name not in ("COLUMNS", "LINES")}
    with subprocess.Popen(
        [sys.executable, "-c", SHOWN],
        stdin=subprocess.PIPE,
        stdout=slave,
        stderr=subprocess.DEVNULL,
        env={**environment, "TERM": "xterm-256color", "COLORTERM": "truecolor"},
        # A group whose parent could continue it, so that Ctrl-Z can stop it.
        preexec_fn=os.setpgrp,
    ) as process:
        stream.feed(read_until(master, b"pad up"))
        process.send_signal(signal.SIGTSTP)
        resize(60, 24)
        # A refresh starts at the top left; after two more everything has been redrawn.
        stream.feed(read_until(master, b"\x1b[H", 4))
        for once in ("touchd", "Last touches", "2.67 s"):
            assert sum(once in line for line in screen.display) == 1, (once, screen.display)
        assert process.stdin is not None
        process.stdin.close()
        left = read_until(master, b"gone")
    assert b"\x1b[?1049l" in left
    assert b"\x1b[?25h" in left
    os.close(slave)
    os.close(master)


def test_ctrl_s_does_not_hold_up_the_output(monkeypatch: pytest.MonkeyPatch) -> None:
    master, slave = pty.openpty()
    with os.fdopen(slave) as terminal:
        monkeypatch.setattr("sys.stdin", terminal)
        with listening(lambda key: None):
            os.write(master, b"\x13")
            os.write(slave, b"shown")
            try:
                read_until(master, b"shown")
            finally:
                os.write(master, b"\x11")
    os.close(master)
