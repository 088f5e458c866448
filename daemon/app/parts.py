"""Makes the daemon's parts from a configuration."""

from __future__ import annotations

import importlib.util
import typing
from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from touchd.daemon.app.config import ConfigError, SceneSettings, Settings, config_errors
from touchd.daemon.bridges.bridge import Bridge, BridgeError
from touchd.daemon.bridges.settings import LslSettings, MqttSettings, Ros2Settings
from touchd.daemon.path.decide import answerable
from touchd.daemon.path.events import UNCERTAIN, Event
from touchd.daemon.path.monitor import PadMonitor
from touchd.daemon.path.pipeline import Pipeline, Viewers
from touchd.daemon.robot.sink import link_to_robot
from touchd.daemon.sinks.journal import open_journal
from touchd.daemon.sinks.labels import Labeller
from touchd.daemon.sinks.sink import Sink
from touchd.daemon.sinks.touch_store import TouchSink, touch_sink
from touchd.drivers.errors import expand_home
from touchd.drivers.frame import COLUMNS, NO_TOUCH, OTHER, ROWS
from touchd.drivers.installed import EXTRAS, how_to_install
from touchd.drivers.pad.parser import FrameParser
from touchd.drivers.pad.port import SensorError, check_port
from touchd.drivers.pad.sensor import FrameQueue, Sensor
from touchd.drivers.queue import Signal
from touchd.model.classifier import Classifier, load_own
from touchd.model.detector import Detector

if typing.TYPE_CHECKING:
    from touchd.daemon.live.server import LiveServer


@dataclass(eq=False)
class PadChannel:
    """One pad: its reader, the queue that the reader fills, and the pipeline that empties it.

    frames: processed so far. is_up: whether frames come; None until the reader has reported it.
    """

    name: str
    queue: FrameQueue
    sensor: Sensor
    pipeline: Pipeline
    frames: int = 0
    is_up: bool | None = None


@dataclass(frozen=True, eq=False)
class Parts:
    """The configured pads and sinks. Nothing runs yet.

    sinks: the robot comes last, so that its own events follow the answer that caused them. live, touches,
    bridges: the sinks that take frames too; None if not configured. labeller: takes labels from any source.
    """

    pads: tuple[PadChannel, ...]
    sinks: tuple[Sink, ...]
    live: LiveServer | None
    touches: TouchSink | None
    bridges: tuple[Bridge, ...]
    labeller: Labeller


@config_errors()
def make_parts(settings: Settings, emit: Callable[[Event], None], viewers: Viewers, arrived: Signal) -> Parts:
    """Return the parts of a daemon; raises TouchdError when the settings cannot be used.

    emit: receives every event. viewers: see `Pipeline`. arrived: set whenever a pad's queue gets an item.
    """
    check_pad(settings)
    models = load_models(settings)
    detector, pads = Detector.load(), []
    for name, pad in settings.pads.items():
        queue = FrameQueue(filled=arrived)
        sensor = Sensor(pad.sensor.port, pad.sensor.baud, FrameParser(pad.sensor.described), queue)
        monitor = PadMonitor(name, sensor.parser)
        pipeline = Pipeline(pad.pipeline, models[name], emit, None, name, viewers, monitor, detector)
        pads.append(PadChannel(name, queue, sensor, pipeline))
    return _with_sinks(tuple(pads), settings, models, emit)


def _with_sinks(
    pads: tuple[PadChannel, ...],
    settings: Settings,
    models: dict[str, Classifier],
    emit: Callable[[Event], None],
) -> Parts:
    """Return the pads with the configured sinks."""
    sinks: list[Sink] = []
    touches: TouchSink | None = None
    live: LiveServer | None = None
    if settings.journal is not None:
        sinks.append(open_journal(settings.journal))
        if settings.journal.keep_touches is not None:
            touches = touch_sink(settings, settings.journal.file, settings.journal.keep_touches)
            sinks.append(touches)
    gestures = {name: model.labels for name, model in models.items()}
    labeller = Labeller(emit, gestures, are_saved=touches is not None)
    if settings.live is not None:
        # It imports asyncio and websockets, which a daemon without a page does not need.
        from touchd.daemon.live.server import LiveServer

        live = LiveServer(settings, models, labeller=labeller if settings.live.label else None)
        sinks.append(live)
    bridges = make_bridges(settings, models)
    sinks += bridges
    if settings.robot is not None:
        sinks.append(link_to_robot(settings, emit))
    return Parts(pads, tuple(sinks), live, touches, bridges, labeller)


def make_bridges(settings: Settings, models: Mapping[str, Classifier]) -> tuple[Bridge, ...]:
    """Return the configured bridges, not yet started.

    models: of each pad. Raises BridgeError when a bridge cannot be used as configured.
    """
    bridges: list[Bridge] = []
    for name, section in settings.bridges.items():
        if section is None:
            continue
        for library in EXTRAS[name]:
            if importlib.util.find_spec(library) is None:
                raise BridgeError(f"{name}: {library} is not installed: {how_to_install(name)}")
        if isinstance(section, LslSettings | Ros2Settings):
            from touchd.daemon.bridges.process import ProcessBridge

            bridges.append(ProcessBridge(section, settings.name, tuple(settings.pads)))
        elif isinstance(section, MqttSettings):
            from touchd.daemon.bridges.mqtt import MqttBridge

            for pad, own in settings.pads.items():
                labels = answerable(own.scene.gestures, models[pad].labels)
                bridges.append(MqttBridge(section, settings.name, pad, labels))
        else:
            from touchd.daemon.bridges.rosbridge import RosbridgeBridge

            bridges += (RosbridgeBridge(section, settings.name, pad) for pad in settings.pads)
    return tuple(bridges)


def load_models(settings: Settings) -> dict[str, Classifier]:
    """Load each pad's model, shared by pads with the same file, and warm it up.

    Raises ModelError, or ConfigError when a model does not fit the scene or the words.
    """
    by_file: dict[str | None, Classifier] = {}
    models: dict[str, Classifier] = {}
    for name, pad in settings.pads.items():
        if pad.model not in by_file:
            by_file[pad.model] = Classifier.load() if pad.model is None else load_own(expand_home(pad.model))
        models[name] = by_file[pad.model]
        # The shipped model fits the scene by default.
        if pad.model is not None or pad.scene != SceneSettings():
            check_scene(pad.scene, models[name])
        # The first answer of each length takes several times longer than later ones.
        for frames in pad.scene.answer_at_frames:
            models[name].probabilities(np.zeros((frames, ROWS, COLUMNS), np.float32))
            models[name].step(np.zeros((frames, ROWS, COLUMNS), np.float32))
    known = {OTHER, UNCERTAIN}.union(*(model.labels for model in models.values()))
    if unknown := sorted(set(settings.words) - known):
        raise ConfigError(f"words.{unknown[0]}: unknown gesture; known: {', '.join(sorted(known))}")
    return models


def load_model(settings: Settings) -> Classifier:
    """Load the only pad's model; see `load_models`."""
    (model,) = load_models(settings).values()
    return model


def check_scene(scene: SceneSettings, classifier: Classifier) -> None:
    """Raise ConfigError when a scene needs gestures or lengths that the model or the scene excludes."""
    known = set(classifier.labels) - {NO_TOUCH}
    acted_on = {gesture for rule in scene.actions for gesture in rule.gestures} - {OTHER, UNCERTAIN}
    for name, gestures in (("scene.gestures", set(scene.gestures)), ("scene.actions", acted_on)):
        if unknown := sorted(gestures - known):
            raise ConfigError(
                f"{name}: {unknown[0]} is not a gesture of the model {classifier.name}; "
                f"it knows {', '.join(sorted(known))}: name those, or leave {name} out"
            )
    if scene.gestures and (never := sorted(acted_on - set(scene.gestures))):
        raise ConfigError(
            f"scene.actions: {never[0]} is never told, as scene.gestures leaves it out; add it there, or "
            "remove it here"
        )
    longest = classifier.metadata.max_length
    if scene.answer_at_frames[-1] > longest:
        raise ConfigError(
            f"scene.answer_at_frames: {scene.answer_at_frames[-1]} is more than "
            f"the {longest} frames that the model {classifier.name} takes"
        )


def check_pad(settings: Settings) -> None:
    """Raise SensorError when the only port can never work.

    The daemon waits for a missing, forbidden or busy port: udev and other programs may be late at boot.
    With several pads, one that cannot work must not stop the others; its events say why.
    """
    if settings.sensors:
        return
    try:
        check_port(settings.sensor.port, settings.sensor.baud)
    except SensorError as error:
        if error.kind == "unusable":
            raise
