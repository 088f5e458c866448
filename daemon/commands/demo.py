"""`touchd demo`: a simulated hand on a fake pad, the real daemon and a stand-in robot, in the terminal."""

from __future__ import annotations

import argparse
import sys
import tempfile
import threading
import time
import typing
from collections import deque
from collections.abc import Callable, Iterable, Sequence
from contextlib import ExitStack, suppress
from functools import partial
from pathlib import Path

import msgspec
from numpy.random import RandomState
from rich.console import Console

from touchd.daemon.app.config import LiveSettings, SceneSettings, SensorSettings, Settings
from touchd.daemon.commands.fake_pad import add_live, serve_page
from touchd.daemon.live.address import EVERY_ADDRESS, parse_address, qr_code
from touchd.daemon.path.events import UNCERTAIN, Event, TouchEnded
from touchd.daemon.playback.rig import SpawnedDaemon, encoder_for
from touchd.daemon.playback.stream import DEMO_RECORDING
from touchd.daemon.robot.actions import Action, ActionRule
from touchd.daemon.robot.words import name_of, words_of
from touchd.daemon.view.describe import describe
from touchd.daemon.view.view import View
from touchd.drivers.fakes.fake_port import FakePort, LivePort
from touchd.drivers.fakes.fake_robot import LoopbackRobot
from touchd.drivers.fakes.hand import PLAYED, SimulatedPad
from touchd.drivers.frame import NO_TOUCH, OTHER, Counts, Frame
from touchd.drivers.installed import program_name
from touchd.drivers.recording import Stream, read_recordings, splice
from touchd.drivers.robot.session import RobotSettings
from touchd.model.classifier import Classifier

if typing.TYPE_CHECKING:
    from touchd.daemon.live.touch import TouchPage

# The recording lasts 37 s; the demo ends within a minute even if something fails.
LONGEST_S = 50.0
SPEECH_S = 0.8
# Interval between the touches of the simulated hand on the page.
EVERY_S = 5.6
PACE = 1.0
# Most touches kept for the summary at the end.
KEPT = 1000

# The robot says what it detects, and corrects itself.
ACTIONS = (
    ActionRule(do=(Action(leds="green"), Action(say="That feels like {phrase}."))),
    ActionRule(do=(Action(animated_say="Oh, it is {phrase}!"),), changed=True),
    ActionRule(do=(Action(say="What was that?"),), gestures=(OTHER, UNCERTAIN)),
)
SETTINGS = Settings(scene=SceneSettings(actions=ACTIONS))
WORDS = words_of(SETTINGS)
NEXT = """
What to try next:
  {touchd} demo --live    a page in your browser on which you touch the pad yourself
  {touchd} classify       all answers to the same recording at once
  {touchd} doctor         looks for a pad and a robot, and says what to do
  {touchd} docs install   how to wire a real pad and a real Nao
"""
DESCRIPTION = "Runs the daemon on a simulated pad, with --live until Ctrl-C; needs no pad, robot or network."


class PlainLines:
    """Output without a terminal: one line for each event."""

    def put_frame(self, frame: Frame) -> None:
        """Do nothing: lines cannot show a moving pad."""

    def note(self, text: str) -> None:
        """Write a line, from any thread; a closed output is ignored here and detected by `put`."""
        with suppress(BrokenPipeError):
            self._write(text)

    # Shows the next gesture of the hand.
    doing = note

    def put(self, event: Event) -> None:
        """Write an event in words; raises BrokenPipeError when the reader has gone."""
        self._write(describe(event, WORDS))

    def _write(self, line: str) -> None:
        sys.stdout.write(f"{line}\n")
        sys.stdout.flush()


Show: typing.TypeAlias = View | PlainLines


def add_options(parser: argparse.ArgumentParser) -> None:
    add_live(parser)


def main(options: argparse.Namespace) -> int:
    """Show the daemon at work for less than a minute, or with a live page until Ctrl-C; returns 0."""
    if options.live is not None:
        return _be_touched(parse_address(options.live, None))
    stream = splice(read_recordings(DEMO_RECORDING))
    with ExitStack() as closing:
        show = _show(closing)
        port = closing.enter_context(FakePort(stream, _showing(stream, show), speed=PACE))
        told = _run(closing, show, port)
    did = [span.gesture for span in stream.spans if span.gesture != NO_TOUCH]
    summary = f"\nThe simulated hand did:  {_names(did)}\nThe robot was told:      {_names(told)}\n"
    sys.stdout.write(summary + NEXT.format(touchd=program_name()))
    return 0


def _be_touched(live: LiveSettings) -> int:
    """Run until Ctrl-C with a page on which viewers touch the simulated pad; returns 0."""
    shown = msgspec.structs.replace(SETTINGS, live=live, robot=RobotSettings(url="tcp://localhost:9559"))
    with ExitStack() as closing:
        page = serve_page(closing, shown, Classifier.load())
        show = _show(closing, page.urls, live.host in EVERY_ADDRESS)

        def put_frame(frame: Frame) -> None:
            show.put_frame(frame)
            page.put_frame(frame)

        begins = partial(_begins, show)
        pad = SimulatedPad(RandomState(), tuple(PLAYED), EVERY_S, page.touching, begins, put_frame)
        port = closing.enter_context(LivePort(pad.scan, encoder_for(SETTINGS.sensor)))
        show.note(f"live page: {' '.join(page.urls)}   Ctrl-C ends")
        _run(closing, show, port, page)
    return 0


def _names(gestures: Iterable[str]) -> str:
    return ", ".join(name_of(WORDS, gesture) for gesture in gestures)


def _show(closing: ExitStack, urls: Sequence[str] = (), is_for_phones: bool = False) -> Show:
    """Return the view on a terminal that can draw it, else plain lines.

    urls: of the live page. is_for_phones: show the first one as a QR code too.
    """
    console = Console()
    if not console.is_terminal or console.is_dumb_terminal:
        return PlainLines()
    title, code = " ".join(urls) or "the daemon at work", qr_code(urls[0]) if is_for_phones else ""
    return closing.enter_context(View(title, SETTINGS, console=console, card=code))


def _run(
    closing: ExitStack, show: Show, port: FakePort | LivePort, page: TouchPage | None = None
) -> Sequence[str]:
    """Run the daemon on a fake port and show its events; return the last answer to each touch.

    Ends when the stream of a FakePort ends. page: shows the events too.
    """
    folder = Path(closing.enter_context(tempfile.TemporaryDirectory(prefix="touchd-demo-")))
    log = closing.enter_context((folder / "log").open("w+b"))
    robot = closing.enter_context(LoopbackRobot(lambda call: None, [f"--say-s={SPEECH_S}"]))
    sensor, to_robot = SensorSettings(port=port.path), RobotSettings(url=robot.url)
    # Live predictions are not events: get them from the daemon's own page, whose address is in its log.
    live = LiveSettings(port=0) if page else None
    settings = msgspec.structs.replace(SETTINGS, sensor=sensor, robot=to_robot, live=live)
    daemon = SpawnedDaemon(settings, folder, log)
    closing.callback(daemon.stop)
    if page is not None:
        page.follow(folder / "log")
    if isinstance(port, FakePort):
        threading.Thread(target=_end, args=(port, daemon), name="touchd-demo-end", daemon=True).start()
    told: deque[str] = deque(maxlen=KEPT)
    for event in daemon.events():
        if page is not None:
            page.put(event)
        show.put(event)
        if isinstance(event, TouchEnded):
            told.append(event.gesture)
    if daemon.stop() != 0 or not told:
        log.seek(0)
        raise RuntimeError(f"the daemon ended early: {log.read().decode(errors='replace').strip()}")
    return told


def _end(port: FakePort, daemon: SpawnedDaemon) -> None:
    port.wait(LONGEST_S)
    daemon.process.terminate()


def _begins(show: Show, gesture: str) -> None:
    show.doing(f"the simulated hand: {_names([gesture])}")


def _showing(stream: Stream, show: Show) -> Callable[[Counts, int], bytes]:
    """Return the pad's encoder, which also shows each frame, and each gesture as it begins."""
    encode = encoder_for(SETTINGS.sensor)
    touches = (span for span in stream.spans if span.gesture != NO_TOUCH)
    begins = {int(stream.sensor_ms[span.start]): span.gesture for span in touches}

    def shown(counts: Counts, sensor_ms: int) -> bytes:
        show.put_frame(Frame(sensor_ms, time.monotonic(), counts))
        if sensor_ms in begins:
            _begins(show, begins[sensor_ms])
        return encode(counts, sensor_ms)

    return shown
