"""`touchd demo`: a simulated hand on a fake pad, the real daemon and a stand-in robot, in the terminal."""

from __future__ import annotations

import argparse
import statistics
import sys
import tempfile
import threading
import typing
from collections import deque
from collections.abc import Callable, Sequence
from contextlib import ExitStack, suppress
from pathlib import Path

import msgspec

from daemon.config import LiveSettings, RobotConfig, SceneSettings, SensorSettings, Settings
from daemon.destinations import encoder_for
from daemon.events import Event, Prediction, TouchEnded
from daemon.live.address import listen, parse_address, require_library, urls_of
from daemon.playback.rig import SpawnedDaemon
from daemon.playback.stream import DEMO_RECORDING
from daemon.sinks import RobotSink
from daemon.terminal.describe import describe
from drivers.fakes.fake_port import FakePort
from drivers.fakes.fake_robot import LoopbackRobot, StubRobot
from drivers.fakes.services import Call
from drivers.frame import FRAME_RATE_HZ, Counts
from drivers.recording import Stream, read_recordings, splice
from drivers.robot.actions import Action, ActionRule, Leds
from drivers.robot.link import RobotLink, RobotSettings
from drivers.robot.session import qi_installed

# The recording lasts 37 s; whatever goes wrong, the demo is over before a minute is.
LONGEST_S = 50.0
SPEECH_S = 0.8
PACE = 1.0
# Answers that are counted at the end.
KEPT = 1000

ACTIONS = (
    ActionRule(do=(Action(leds=Leds(color="green")), Action(say="That feels like {gesture}."))),
    ActionRule(do=(Action(animated_say="Oh, it is {gesture}!"),), changed=True),
    ActionRule(do=(Action(say="What was that?"),), gestures=("uncertain",)),
)

NEXT = """
What to try next:
  touchd replay FILE.csv.gz        a recording as a pad; prints a fake serial port
  touchd run --view --port PORT    the daemon on that port, or on a real pad
  touchd demo --live               the same on a page for browsers, again and again
  touchd classify FILE.csv.gz      all answers to a recording at once
docs/install.md tells how to wire a real pad and a real Nao.
"""


class Show(typing.Protocol):
    """Where the demo shows what happens: the terminal view, or plain lines."""

    def show_frame(self, pressure: Counts) -> None:
        """Show a frame."""
        ...

    def note(self, text: str, style: str = "") -> None:
        """Show a line."""
        ...

    def put(self, event: Event) -> None:
        """Show an event."""
        ...


class PlainLines:
    """A show for where there is no terminal: one line for each thing that happens."""

    def show_frame(self, pressure: Counts) -> None:
        """Lines cannot show a pad that moves."""

    def note(self, text: str, style: str = "") -> None:
        """Write a line; from any thread, so that a reader who is gone is left to `put` to notice."""
        with suppress(BrokenPipeError):
            self._write(text)

    def put(self, event: Event) -> None:
        """Write an event in words; raises BrokenPipeError when nobody reads any more."""
        self._write(describe(event))

    def _write(self, text: str) -> None:
        sys.stdout.write(f"{text}\n")
        sys.stdout.flush()


def parser() -> argparse.ArgumentParser:
    """Return what the command line takes."""
    parser = argparse.ArgumentParser(prog="touchd demo", description="Needs no pad, no robot and no network.")
    parser.add_argument("--plain", action="store_true", help="lines instead of a picture")
    parser.add_argument(
        "--live", nargs="?", const="", metavar="[HOST:]PORT", help="also on a page for browsers, until Ctrl-C"
    )
    return parser


def main(arguments: Sequence[str]) -> int:
    """Show the daemon at work for less than a minute, or with a live page until Ctrl-C; returns 0."""
    options = parser().parse_args(arguments)
    live = None if options.live is None else _available(parse_address(options.live, None))
    stream = splice(read_recordings(DEMO_RECORDING))
    with ExitStack() as closing:
        show = PlainLines() if options.plain else _show(closing)
        predictions, told = _play(stream, show, closing, live)
    hand = [span.gesture for span in stream.spans if span.gesture != "notouch"]
    latencies = [prediction.latency_ms for prediction in predictions]
    lines = [
        "",
        f"The simulated hand did:  {', '.join(hand)}",
        f"The robot was told:      {', '.join(told)}",
        f"{len(latencies)} answers, half of them within {statistics.median(latencies):.1f} ms of a frame.",
        NEXT,
    ]
    sys.stdout.write("\n".join(lines))
    return 0


def _available(live: LiveSettings) -> LiveSettings:
    """Return the settings with the port that 0 stands for; raises LiveError when no page can be served so."""
    require_library()
    with listen(live) as listening:
        return msgspec.structs.replace(live, port=listening.getsockname()[1])


def _show(closing: ExitStack) -> Show:
    """Return the view where there is a terminal to draw in, plain lines elsewhere."""
    from rich.console import Console

    console = Console()
    if not console.is_terminal or console.is_dumb_terminal:
        return PlainLines()
    from daemon.terminal.view import View

    return closing.enter_context(View("a simulated hand, the real daemon, a stand-in robot", console))


def _play(
    stream: Stream, show: Show, closing: ExitStack, live: LiveSettings | None
) -> tuple[Sequence[Prediction], Sequence[str]]:
    """Play the stream to the daemon and show what comes of it; returns all answers, and each touch's last.

    live: where to serve the live page; with one, the stream begins anew whenever it ends.
    """
    folder = Path(closing.enter_context(tempfile.TemporaryDirectory(prefix="touchd-demo-")))
    log = closing.enter_context((folder / "log").open("w+b"))
    sensor = SensorSettings()
    encode = _showing(stream, encoder_for(sensor), show)
    port = closing.enter_context(FakePort(stream, encode, speed=PACE, loop=live is not None))
    settings = Settings(
        sensor=msgspec.structs.replace(sensor, port=port.path),
        scene=SceneSettings(actions=ACTIONS),
        live=live,
        log_level="warning",
    )

    def show_call(call: Call) -> None:
        if words := _words(call):
            show.note(words, "cyan")

    forward: Callable[[Event], None] | None = None
    if qi_installed():
        robot = closing.enter_context(LoopbackRobot(say_s=SPEECH_S, on_call=show_call))
        settings = msgspec.structs.replace(settings, robot=RobotConfig(url=robot.url))
    else:
        # The stub lives in this process, so its link does too, fed with the daemon's events.
        stub = closing.enter_context(StubRobot(say_s=SPEECH_S, on_call=show_call))
        link = RobotLink(RobotSettings(url=stub.url, actions=ACTIONS), open_session=stub.open_session)
        forward = RobotSink(link).put
        closing.callback(link.stop)
    daemon = SpawnedDaemon(settings, folder, log)
    closing.callback(daemon.stop)
    if live is None:
        threading.Thread(target=_end, args=(port, daemon), name="touchd-demo-end", daemon=True).start()
    else:
        show.note(f"live page: {' '.join(urls_of(live, live.port))}   Ctrl-C ends", "bold")
    predictions: deque[Prediction] = deque(maxlen=KEPT)
    told: deque[str] = deque(maxlen=KEPT)
    for event in daemon.events():
        show.put(event)
        if forward is not None:
            forward(event)
        if isinstance(event, Prediction):
            predictions.append(event)
        elif isinstance(event, TouchEnded):
            told.append(event.gesture)
    if daemon.stop() != 0 or not predictions:
        log.seek(0)
        raise RuntimeError(f"the daemon ended early: {log.read().decode(errors='replace').strip()}")
    return predictions, told


def _end(port: FakePort, daemon: SpawnedDaemon) -> None:
    port.wait(LONGEST_S)
    daemon.process.terminate()


def _showing(
    stream: Stream, encode: Callable[[Counts, int], bytes], show: Show
) -> Callable[[Counts, int], bytes]:
    """Return `encode` such that what is sent is also shown, and what the hand does is said as it begins."""
    first_ms, last_ms = int(stream.sensor_ms[0]), int(stream.sensor_ms[-1])
    # A stream that is played again goes on by the clock.
    length_ms = last_ms - first_ms + round(1000 / FRAME_RATE_HZ)
    begins = {int(stream.sensor_ms[span.start]) - first_ms: span.gesture for span in stream.spans}

    def shown(counts: Counts, sensor_ms: int) -> bytes:
        show.show_frame(counts)
        gesture = begins.get((sensor_ms - first_ms) % length_ms, "notouch")
        if gesture != "notouch":
            show.note(f"the simulated hand: {gesture}", "yellow")
        return encode(counts, sensor_ms)

    return shown


def _words(call: Call) -> str:
    """Return what the stand-in robot does as one line, empty for what only helps it along."""
    if call.refused:
        return f"robot refuses {call.method}: {call.refused}"
    first = call.arguments[0] if call.arguments else ""
    match call.method:
        case "raiseEvent":
            event = str(first).rpartition("/")[2]
            return "" if event == "Detail" else f"robot hears {event}: {call.arguments[1]}"
        case "say":
            return f'robot says "{first}"'
        case "runBehavior":
            return f"robot does {first}"
        case _:
            return ""
