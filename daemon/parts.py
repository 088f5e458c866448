"""Makes the daemon's parts from a configuration; what is not configured is not imported."""

from __future__ import annotations

import time
import typing
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from touchd.daemon.bridges.settings import MEMORY_FILES
from touchd.daemon.config import ConfigError, JournalSettings, SceneSettings, Settings, config_errors
from touchd.daemon.events import (
    MAX_REASON_BYTES,
    UNCERTAIN,
    ActionKind,
    Event,
    Prediction,
    RobotAction,
    RobotEvent,
    timestamp,
)
from touchd.daemon.journal import Journal, JournalError, JournalSink
from touchd.daemon.monitor import PadMonitor
from touchd.daemon.pipeline import Pipeline, Viewers
from touchd.daemon.sinks import RobotSink, Sink
from touchd.drivers.errors import one_line, os_errors_as
from touchd.drivers.frame import COLUMNS, NO_TOUCH, ROWS
from touchd.drivers.pad.port import SensorError, check_port
from touchd.drivers.pad.protocol import parser_of
from touchd.drivers.pad.sensor import FrameQueue, Sensor
from touchd.drivers.queue import Signal
from touchd.drivers.robot.link import RobotLink
from touchd.drivers.robot.session import OpenSession
from touchd.drivers.robot.worker import LinkState
from touchd.model.classifier import Classifier

if typing.TYPE_CHECKING:
    from touchd.daemon.bridges.bridge import Bridge
    from touchd.daemon.kept.touch_store import TouchSink
    from touchd.daemon.labels import Labeller
    from touchd.daemon.live.server import LiveServer

BYTES_PER_MB = 1_000_000

Emit = Callable[[Event], None]


@dataclass(frozen=True, eq=False)
class PadChannel:
    """One pad: its reader, the queue that the reader fills, and the pipeline that empties it."""

    name: str
    model: Classifier
    queue: FrameQueue
    sensor: Sensor
    pipeline: Pipeline


@dataclass(frozen=True, eq=False)
class Parts:
    """The configured pads and sinks; a sink that is not configured is None. Nothing runs yet.

    labeller: takes the labels of the live page, None if it takes none. Others share it, so that all labels
    are counted together.
    """

    pads: tuple[PadChannel, ...]
    journal: JournalSink | None
    live: LiveServer | None
    kept: TouchSink | None
    robot: RobotSink | None
    bridges: tuple[Bridge, ...]
    labeller: Labeller | None

    @property
    def sinks(self) -> tuple[Sink, ...]:
        one_each = (self.journal, self.live, self.kept, self.robot)
        return (*(sink for sink in one_each if sink is not None), *self.bridges)


@config_errors()
def make_parts(
    settings: Settings, emit: Emit, viewers: Viewers, arrived: Signal, config: Path | None = None
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
        pipeline = Pipeline(
            pad.pipeline,
            models[name],
            emit,
            pad=name,
            viewers=viewers,
            first_index=number,
            monitor=PadMonitor(name, sensor.parser, sensor.where),
        )
        pads.append(PadChannel(name, models[name], queue, sensor, pipeline))
    takes_labels = settings.live is not None and settings.live.label
    labeller = make_labeller(settings, models, emit) if takes_labels else None
    return Parts(
        pads=tuple(pads),
        labeller=labeller,
        kept=keep_touches(settings),
        robot=link_to_robot(settings, emit),
        journal=open_journal(settings.journal),
        live=open_live_page(settings, models, labeller),
        bridges=bridges_to_others(settings, models, config),
    )


def open_journal(settings: JournalSettings | None) -> JournalSink | None:
    """Return the configured journal, if any; raises JournalError."""
    if settings is None:
        return None
    _make_state_folder(settings)
    max_bytes = round(settings.max_mb * BYTES_PER_MB)
    return JournalSink(Journal(settings.file, max_bytes=max_bytes, keep=settings.keep))


def keep_touches(settings: Settings) -> TouchSink | None:
    """Return the sink that saves the frames of touches, if configured; raises ConfigError."""
    journal = settings.journal
    if journal is None or journal.keep_touches is None:
        return None
    from touchd.daemon.kept.touch_store import TouchSink, open_stores

    _make_state_folder(journal)
    pads = {name: pad.sensor for name, pad in settings.pads.items()}
    return TouchSink(open_stores(journal.file, journal.keep_touches, pads))


def _make_state_folder(settings: JournalSettings) -> None:
    """Make the default state folder when it is missing, but not the folder of a configured path."""
    if settings.path is None:
        with os_errors_as(JournalError, f"journal {settings.file}: cannot be written", "set journal: null"):
            settings.file.parent.mkdir(mode=0o700, parents=True, exist_ok=True)


def link_to_robot(
    settings: Settings, emit: Emit, open_session: OpenSession | None = None
) -> RobotSink | None:
    """Return the link to the configured robot, if any; raises RobotError.

    emit: receives an event when the robot comes, goes or acts, from the link's threads.
    open_session: how to reach the robot; real qi by default.
    """

    def report(state: LinkState, reason: str) -> None:
        why = one_line(reason, MAX_REASON_BYTES)
        emit(RobotEvent(state=state, time=timestamp(time.time()), reason=why))

    def note(answer: Prediction, kind: ActionKind, what: str) -> None:
        now = timestamp(time.time())
        shown = one_line(what, MAX_REASON_BYTES)
        emit(RobotAction(touch=answer.touch, action=kind, what=shown, time=now, pad=answer.pad))

    if settings.robot is None:
        return None
    rules = {name: pad.scene.actions for name, pad in settings.pads.items()}
    link = RobotLink(settings.robot, report, open_session, pads=rules, acts=any(rules.values()))
    for name in settings.pads:
        # Report "down" until frames come: a program that waits for "up" must not find a missing pad up.
        link.set_status("down", name)
    if not any(rules.values()):
        return RobotSink(link)
    from touchd.daemon.reactions import Reactions

    return RobotSink(link, Reactions(rules, settings.vocabulary, link.act, note).on_answer)


def open_live_page(
    settings: Settings, models: Mapping[str, Classifier], labeller: Labeller | None = None
) -> LiveServer | None:
    """Return the server of the live page, if one is configured; raises LiveError."""
    if settings.live is None:
        return None
    from touchd.daemon.live.address import listen, require_library

    require_library()
    from touchd.daemon.live.memory import Scene
    from touchd.daemon.live.server import LiveServer

    scenes = {name: Scene(pad, models[name]) for name, pad in settings.pads.items()}
    return LiveServer(listen(settings.live), settings.live, scenes, labeller=labeller)


def make_labeller(settings: Settings, models: Mapping[str, Classifier], emit: Emit) -> Labeller:
    """Return what takes labels of touches; raises RecordingError if kept touches cannot be read."""
    from touchd.daemon.kept.touch_store import folder_of
    from touchd.daemon.labels import Labeller

    journal = settings.journal
    folders = {}
    if journal is not None and journal.keep_touches is not None:
        folders = {name: folder_of(journal.file, name) for name in settings.pads}
    return Labeller(emit, {name: model.labels for name, model in models.items()}, folders)


def bridges_to_others(
    settings: Settings, models: Mapping[str, Classifier], config: Path | None = None
) -> tuple[Bridge, ...]:
    """Return the configured bridges, and what clears the traces of former ones; raises BridgeError."""
    state = JournalSettings().file.parent
    has_traces = config is not None and any(state.glob(MEMORY_FILES))
    if not any(settings.bridges.values()) and not has_traces:
        return ()
    from touchd.daemon.bridges.bridges import make_bridges

    gestures = {
        name: pad.scene.gestures or tuple(label for label in models[name].labels if label != NO_TOUCH)
        for name, pad in settings.pads.items()
    }
    return tuple(make_bridges(settings.bridges, gestures, state, config))


def load_model(settings: Settings) -> Classifier:
    """Load the configured model; raises ModelError, or ConfigError when it does not fit the scene."""
    if settings.model_path is None:
        classifier = Classifier.load()
    else:
        from touchd.model.own_file import load_own

        classifier = load_own(settings.model_path)
    check_fit(settings.scene, classifier)
    # Warm up: the first answer of each length takes several times longer than those after it.
    for frames in settings.scene.answer_at_frames:
        classifier.probabilities(np.zeros((frames, ROWS, COLUMNS), np.float32))
        classifier.step(np.zeros((frames, ROWS, COLUMNS), np.float32))
    return classifier


def load_models(settings: Settings) -> dict[str, Classifier]:
    """Load each pad's model, shared by pads with the same file; see `load_model`."""
    by_path: dict[object, Classifier] = {}
    models: dict[str, Classifier] = {}
    for name, pad in settings.pads.items():
        path = pad.model_path
        if path in by_path:
            check_fit(pad.scene, by_path[path])
        else:
            by_path[path] = load_model(pad)
        models[name] = by_path[path]
    known = {UNCERTAIN}.union(*(model.labels for model in models.values()))
    if unknown := sorted(set(settings.words) - known):
        raise ConfigError(f"words.{unknown[0]}: unknown gesture; known: {', '.join(sorted(known))}")
    return models


def check_fit(scene: SceneSettings, classifier: Classifier) -> None:
    """Raise ConfigError when a scene asks for gestures or lengths that the model or the scene rules out."""
    known = set(classifier.labels) - {NO_TOUCH}
    acted_on = {gesture for rule in scene.actions for gesture in rule.gestures} - {UNCERTAIN}
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
