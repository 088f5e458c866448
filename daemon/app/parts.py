"""Makes the daemon's parts from a configuration; what is not configured is not imported."""

from __future__ import annotations

import typing
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from touchd.daemon.app.config import JournalSettings, SceneSettings, Settings, config_errors
from touchd.daemon.bridges.settings import MEMORY_FILES
from touchd.daemon.path.events import Event
from touchd.daemon.path.monitor import PadMonitor
from touchd.daemon.path.pipeline import Pipeline, Viewers
from touchd.daemon.sinks.sink import Sink
from touchd.drivers.errors import written_out
from touchd.drivers.frame import COLUMNS, ROWS
from touchd.drivers.pad.port import SensorError, check_port
from touchd.drivers.pad.protocol import parser_of
from touchd.drivers.pad.sensor import FrameQueue, Sensor
from touchd.drivers.queue import Signal
from touchd.model.classifier import Classifier

if typing.TYPE_CHECKING:
    from touchd.daemon.bridges.bridge import Bridge
    from touchd.daemon.live.server import LiveServer
    from touchd.daemon.sinks.labels import Labeller
    from touchd.daemon.sinks.touch_store import TouchSink


@dataclass(eq=False)
class PadChannel:
    """One pad: its reader, the queue that the reader fills, and the pipeline that empties it.

    frames: processed so far. is_up: None until the reader has said whether frames come.
    """

    name: str
    model: Classifier
    queue: FrameQueue
    sensor: Sensor
    pipeline: Pipeline
    frames: int = 0
    is_up: bool | None = None


@dataclass(frozen=True, eq=False)
class Parts:
    """The configured pads and sinks. Nothing runs yet.

    sinks: the robot comes last, so that its own events follow the answer that caused them. live, kept,
    bridges: those of the sinks that take frames, too; None if not configured. labeller: takes the labels of
    the live page, None if it takes none. Others share it, so that all labels are counted together.
    """

    pads: tuple[PadChannel, ...]
    sinks: tuple[Sink, ...]
    live: LiveServer | None
    kept: TouchSink | None
    bridges: tuple[Bridge, ...]
    labeller: Labeller | None


@config_errors()
def make_parts(
    settings: Settings,
    emit: Callable[[Event], None],
    viewers: Viewers,
    arrived: Signal,
    config: Path | None = None,
) -> Parts:
    """Return the parts of a daemon; raises TouchdError when the settings cannot be used.

    emit: receives every event. viewers: see `Pipeline`. arrived: is set whenever a pad's queue has something.
    config: the file of the settings, by which a bridge knows what an earlier version of it left on a broker.
    """
    check_pad(settings)
    models = load_models(settings)
    pads = []
    for number, (name, pad) in enumerate(settings.pads.items()):
        queue = FrameQueue(filled=arrived)
        sensor = Sensor(pad.sensor.port, pad.sensor.baud, parser_of(pad.sensor.described), queue)
        monitor = PadMonitor(name, sensor.parser, sensor.where)
        pipeline = Pipeline(pad.pipeline, models[name], emit, None, name, viewers, number, monitor)
        pads.append(PadChannel(name, models[name], queue, sensor, pipeline))
    sinks: list[Sink] = []
    kept: TouchSink | None = None
    live: LiveServer | None = None
    labeller: Labeller | None = None
    if settings.journal is not None:
        from touchd.daemon.sinks.journal import open_journal

        sinks.append(open_journal(settings.journal))
        if settings.journal.keep_touches is not None:
            from touchd.daemon.sinks.touch_store import keep_touches

            kept = keep_touches(settings)
            sinks.append(kept)
    if settings.live is not None:
        if settings.live.label:
            from touchd.daemon.sinks.labels import make_labeller

            labeller = make_labeller(settings, models, emit)
        from touchd.daemon.live.server import open_live_page

        live = open_live_page(settings, models, labeller)
        sinks.append(live)
    bridges: tuple[Bridge, ...] = ()
    state = JournalSettings().file.parent
    # A former configuration may have left something on a broker, which is cleared.
    if any(settings.bridges.values()) or (config is not None and any(state.glob(MEMORY_FILES))):
        from touchd.daemon.bridges.bridges import make_bridges

        bridges = make_bridges(settings, models, state, config)
        sinks += bridges
    if settings.robot is not None:
        from touchd.daemon.robot.sink import link_to_robot

        sinks.append(link_to_robot(settings, emit))
    return Parts(tuple(pads), tuple(sinks), live, kept, bridges, labeller)


def load_models(settings: Settings) -> dict[str, Classifier]:
    """Load each pad's model, shared by pads with the same file, and warm it up.

    Raises ModelError, or ConfigError when a model does not fit the scene or the words.
    """
    pads = settings.pads
    by_file = {file: _load(file) for file in {pad.model for pad in pads.values()}}
    models = {name: by_file[pad.model] for name, pad in pads.items()}
    for name, pad in pads.items():
        # The shipped model fits the scene by default.
        if pad.model is not None or pad.scene != SceneSettings():
            from touchd.daemon.app.fit import check_scene

            check_scene(pad.scene, models[name])
        # The first answer of each length takes several times longer than those after it.
        for frames in pad.scene.answer_at_frames:
            models[name].probabilities(np.zeros((frames, ROWS, COLUMNS), np.float32))
            models[name].step(np.zeros((frames, ROWS, COLUMNS), np.float32))
    if settings.words:
        from touchd.daemon.app.fit import check_words

        check_words(settings.words, models.values())
    return models


def _load(file: str | None) -> Classifier:
    if file is None:
        return Classifier.load()
    from touchd.model.own_file import load_own

    return load_own(written_out(file))


def check_pad(settings: Settings) -> None:
    """Raise SensorError when the only port can never work.

    A missing, forbidden or busy port is waited for: udev and other programs may be late at boot.
    With several pads, one that cannot work must not stop the others; its events say why.
    """
    if settings.sensors:
        return
    try:
        check_port(settings.sensor.port, settings.sensor.baud)
    except SensorError as error:
        if error.kind == "unusable":
            raise
