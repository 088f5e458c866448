"""Where the time goes from a frame's last byte to the robot: a bar a stage in docs/speed.md.

`python -m touchd.model.studies stages` runs the daemon on a fake pad in another process, which is
touched repeatedly, and notes when each answer told at a mark passed each stage. The robot is a stand-in
behind real qi on loopback. The figures are kept in docs/speed.json. Needs the extra `nao`.
"""

import math
import multiprocessing
import sys
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from multiprocessing.connection import Connection
from typing import Any
from unittest import mock

import msgspec
import numpy as np
from numpy.typing import NDArray

from touchd.daemon.commands.bench import touched
from touchd.daemon.commands.run import favour_latency
from touchd.daemon.config import SensorSettings, Settings
from touchd.daemon.events import Event, Prediction
from touchd.daemon.health import Health, Notifier
from touchd.daemon.pipeline import STAGES as MARKS
from touchd.daemon.pipeline import Pipeline
from touchd.daemon.service import Service
from touchd.daemon.setup.destinations import encoder_for
from touchd.daemon.sinks import EventFanout
from touchd.drivers.errors import TouchdError
from touchd.drivers.fakes.fake_port import FakePort
from touchd.drivers.fakes.loopback_robot import LoopbackRobot
from touchd.drivers.fakes.services import Call
from touchd.drivers.frame import Frame
from touchd.drivers.pad.sensor import FrameQueue
from touchd.drivers.robot.settings import RobotSettings
from touchd.model.classifier import Classifier
from touchd.model.studies.folders import study_parser
from touchd.model.studies.marked import fill, table

STAGES = (
    "the port and the reader's waking",
    "parsing",
    "the loop's waking",
    "grid and touch tracker",
    "the network",
    "decision and event",
    "link, qi and ALMemory",
)
BAR_MS = 0.05
"""What one block of a bar stands for."""
GESTURE = "TouchGesture/Gesture"
REST_S = 4.0
PASSED = ("arrived", "parsed", "taken", "asked", "answered", "told")


class NotTimedError(TouchdError):
    """Nothing came through that could be timed."""


class Times(msgspec.Struct, frozen=True, kw_only=True):
    """Milliseconds of each of STAGES, median over the answers told at a mark, and from first to last."""

    answers: int
    stages_ms: tuple[float, ...]
    p50_ms: float
    p99_ms: float


def main(arguments: Sequence[str]) -> int:
    """Measure, keep the figures under a name, and fill the page's table; returns 0."""
    parser = study_parser("stages", None, "docs")
    parser.add_argument("--seconds", type=float, default=60.0, help="how long to touch the pad (%(default)s)")
    parser.add_argument("--as", dest="name", default="now", choices=("before", "now"), help="(%(default)s)")
    chosen = parser.parse_args(arguments)
    kept = chosen.docs / "speed.json"
    times = msgspec.json.decode(kept.read_bytes(), type=dict[str, Times]) if kept.exists() else {}
    times[chosen.name] = measure(chosen.seconds)
    kept.write_bytes(msgspec.json.format(msgspec.json.encode(times)) + b"\n")
    fill(chosen.docs / "speed.md", {"stages": stages_table(times)})
    sys.stdout.write(f"{chosen.docs / 'speed.md'}: {times[chosen.name]}\n")
    return 0


def stages_table(times: dict[str, Times]) -> str:
    """Return a row a stage with its milliseconds and a bar, for each name."""
    rows: list[tuple[object, ...]] = [
        (stage, *(cell for each in times.values() for cell in (f"{each.stages_ms[n]:.2f}", _bar(each, n))))
        for n, stage in enumerate(STAGES)
    ]
    rows.append(
        ("in all, p50 / p99", *(c for t in times.values() for c in (f"{t.p50_ms:.2f} / {t.p99_ms:.2f}", "")))
    )
    return table(("stage", *(c for name in times for c in (f"{name}, ms", ""))), rows)


def _bar(times: Times, stage: int) -> str:
    return "█" * round(times.stages_ms[stage] / BAR_MS)


def measure(seconds: float) -> Times:
    """Touch a pad for so long, and return how long the answers told at a mark took."""
    ours, theirs = multiprocessing.Pipe()
    pad = multiprocessing.get_context("spawn").Process(target=_pad, args=(theirs, seconds), daemon=True)
    pad.start()
    rows: list[tuple[float, ...]] = []
    sent_s: list[NDArray[np.float64]] = []
    stop = threading.Event()

    def end() -> None:
        sent_s.append(ours.recv())
        stop.set()

    calls: list[Call] = []
    with LoopbackRobot(calls.append) as robot, _noted(rows):
        settings = Settings(sensor=SensorSettings(port=ours.recv()), robot=RobotSettings(url=robot.url))
        service = Service(settings, Health(Notifier({})))
        favour_latency()
        threading.Thread(target=end, daemon=True).start()
        service.run(stop)
        raised_s = [
            call.time_s for call in calls if call.method == "raiseEvent" and call.arguments[0] == GESTURE
        ]
    pad.join()
    boot_s = time.time() - time.monotonic()
    return times_of(sent_s[0], rows, [at_s - boot_s for at_s in raised_s])


def times_of(
    sent_s: NDArray[np.float64], rows: Sequence[tuple[float, ...]], raised_s: Sequence[float]
) -> Times:
    """Return the figures of answers that passed PASSED at these times.

    sent_s, raised_s: when each frame was sent, and when the robot was told. All in seconds of one clock, in
    order. Raises NotTimedError where no answer is left.
    """
    told = min(len(rows), len(raised_s))
    arrived = np.array(rows[:told]).reshape(told, len(PASSED))
    frames = np.searchsorted(sent_s, arrived[:, 0]) - 1
    passed = np.column_stack([sent_s[frames], arrived, raised_s[:told]])
    steps_ms = 1000 * np.diff(passed, axis=1)
    # An answer that waited for a quiet time to end was computed earlier.
    steps_ms = steps_ms[(steps_ms >= 0).all(axis=1)]
    if not len(steps_ms):
        raise NotTimedError("no answer could be followed to the robot: touch longer, on a machine at rest")
    in_all_ms = steps_ms.sum(axis=1)
    return Times(
        answers=len(steps_ms),
        stages_ms=tuple(np.median(steps_ms, axis=0).round(3).tolist()),
        p50_ms=round(float(np.median(in_all_ms)), 3),
        p99_ms=round(float(np.percentile(in_all_ms, 99)), 3),
    )


def _pad(to: Connection, seconds: float) -> None:
    """Play a pad that rests and is then touched; send its port and, at the end, when each frame was sent."""
    with FakePort(touched(seconds, REST_S), encoder_for(SensorSettings())) as port:
        to.send(port.path)
        port.wait(REST_S + seconds + 60)
        to.send(port.sent_s)


@contextmanager
def _noted(rows: list[tuple[float, ...]]) -> Iterator[None]:
    """Within the context, append when each told answer passed each stage, from the frame's arrival on."""
    at: dict[str, float] = {}

    def now(stage: str) -> None:
        at[stage] = time.monotonic()

    def taken(_: Pipeline, frame: Frame) -> None:
        at["arrived"] = frame.host_s
        now("taken")

    def told(_: EventFanout, event: Event) -> None:
        if isinstance(event, Prediction) and event.told:
            now("told")
            # Answers at a touch's end were not computed by steps.
            rows.append(tuple(at[name] if event.stage in MARKS else math.nan for name in PASSED))

    def noting(own: Callable[..., Any], before: Callable[..., None], after: str) -> Callable[..., Any]:
        def noted(*arguments: Any) -> Any:
            before(*arguments)
            returned = own(*arguments)
            now(after)
            return returned

        return noted

    with ExitStack() as undo:
        for owner, name, before, after in (
            (FrameQueue, "put", lambda *_: now("parsed"), "put"),
            (Pipeline, "take", taken, "followed"),
            (Classifier, "steps", lambda *_: now("asked"), "answered"),
            (EventFanout, "emit", told, "emitted"),
        ):
            noted = noting(getattr(owner, name), before, after)
            undo.enter_context(mock.patch.object(owner, name, noted))
        yield
