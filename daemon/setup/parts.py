"""Makes the daemon's parts from a configuration, at start and at every reload."""

from __future__ import annotations

import itertools
import typing
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack, suppress
from functools import partial

import msgspec
import numpy as np

from touchd.daemon.bridges.bridge import Bridge
from touchd.daemon.bridges.bridges import Key, make_bridges
from touchd.daemon.config import ConfigError, SceneSettings, Settings
from touchd.daemon.decide import NO_TOUCH
from touchd.daemon.events import UNCERTAIN, Event
from touchd.daemon.kept.touch_sink import TouchSink
from touchd.daemon.pipeline import Pipeline, Viewers
from touchd.daemon.setup.destinations import link_to_robot, open_journal, open_live_page, open_touch_stores
from touchd.daemon.sinks import JournalSink, RobotSink, Sink
from touchd.drivers.frame import COLUMNS, ROWS
from touchd.drivers.pad.protocol import parser_of
from touchd.drivers.pad.sensor import FrameQueue, Sensor, SensorError, check_port
from touchd.drivers.pad.watch import PadWatch
from touchd.drivers.queue import Signal
from touchd.model.classifier import SHIPPED_MODEL, Classifier

if typing.TYPE_CHECKING:
    from touchd.daemon.live.server import LiveServer

Emit = Callable[[Event], None]


class Pad:
    """One pad: its reader, the queue that this fills, and the pipeline that empties it.

    settings: those of this pad. make_pipeline: makes its pipeline, perhaps from the one before.
    arrived: set whenever something waits in the queue.
    before: the same pad under the previous settings; its queue is kept, and its reader if the port stays.
    """

    def __init__(
        self,
        name: str,
        settings: Settings,
        model: Classifier,
        make_pipeline: Callable[..., Pipeline],
        arrived: Signal,
        before: Pad | None,
    ) -> None:
        self.name = name
        self.settings = settings
        self.model = model
        self.model_file = model_file(settings)
        self._make_pipeline = make_pipeline
        self.pipeline = make_pipeline()
        self.queue: FrameQueue = before.queue if before else FrameQueue(filled=arrived)
        self.watch: PadWatch = before.watch if before else PadWatch(name)
        sensor = settings.sensor
        self.sensor: Sensor
        # A reader goes on where nothing but the pad's size differs.
        if before and sensor == msgspec.structs.replace(before.settings.sensor, size_mm=sensor.size_mm):
            self.sensor = before.sensor
        else:
            self.sensor = Sensor(sensor.port, sensor.baud, parser_of(sensor.described), self.queue)

    def go_on_from(self, before: Pad) -> None:
        """Replace the same pad under the previous settings, between two touches."""
        self.pipeline = self._make_pipeline(before=before.pipeline)


class Parts:
    """Models, pads and sinks as configured; None for a sink that is not.

    emit: takes every event. viewers: see `Pipeline`. arrived: see `Pad`.
    numbers: of messages to a robot.
    before: the running parts; unchanged ones are taken over.
    Nothing runs before it is started. Raises TouchdError when the settings cannot be used, and leaves nothing
    behind.
    """

    def __init__(
        self,
        settings: Settings,
        emit: Emit,
        viewers: Viewers,
        arrived: Signal,
        numbers: Iterator[int],
        before: Parts | None = None,
    ) -> None:
        self.settings = settings
        self.changed = [
            name
            for name in Settings.__struct_fields__
            if before is None or getattr(before.settings, name) != getattr(settings, name)
        ]
        changed = set(self.changed)
        pads_before: Mapping[str, Pad] = before.pads if before else {}
        if before is None or settings.sensor.port != before.settings.sensor.port:
            check_pad(settings)
        models = load_models(settings, pads_before)
        # Also those of pads that are gone: one may come back.
        self._touch_numbers: dict[str, Iterator[int]] = before._touch_numbers if before else {}
        self.pads: dict[str, Pad] = {
            name: Pad(
                name,
                pad,
                models[name],
                partial(
                    Pipeline,
                    pad.pipeline,
                    models[name],
                    emit,
                    pad=name,
                    viewers=viewers,
                    first_index=number,
                    numbers=self._touch_numbers.setdefault(name, itertools.count(1)),
                ),
                arrived,
                pads_before.get(name),
            )
            for number, (name, pad) in enumerate(settings.pads.items())
        }
        if before is not None and "model" not in changed and before.has_other_models:
            self.changed.append("model")
        self.robot: RobotSink | None = before.robot if before else None
        acts_before = before.settings.scene.actions if before else None
        if changed & {"robot", "sensors", "language", "words"} or settings.scene.actions != acts_before:
            link = link_to_robot(settings, emit)
            self.robot = RobotSink(link, numbers) if link else None
        self.kept: TouchSink | None = before.kept if before else None
        if changed & {"journal", "sensor", "sensors"}:
            stores = open_touch_stores(settings)
            self.kept = TouchSink(stores, self.kept) if stores else None
        self.bridges: dict[Key, Bridge] = make_bridges(settings, models, before.bridges if before else {})
        self.journal: JournalSink | None = before.journal if before else None
        self.live: LiveServer | None = before.live if before else None
        with ExitStack() as undo:
            if "journal" in changed:
                journal = open_journal(settings.journal, self.journal.journal if self.journal else None)
                self.journal = JournalSink(journal) if journal else None
                if journal:
                    undo.callback(journal.close)
            if "live" in changed or list(pads_before) != list(self.pads):
                self.live = open_live_page(settings, models, self.live)
            undo.pop_all()

    @property
    def has_other_models(self) -> bool:
        """Whether a model's file has been replaced since it was read."""
        return any(pad.model_file != model_file(pad.settings) for pad in self.pads.values())

    @property
    def models(self) -> dict[str, Classifier]:
        return {name: pad.model for name, pad in self.pads.items()}

    @property
    def sinks(self) -> tuple[Sink, ...]:
        one_each = (self.journal, self.robot, self.live, self.kept)
        return (*(sink for sink in one_each if sink is not None), *self.bridges.values())


def model_file(settings: Settings) -> tuple[object, ...]:
    """Return which file a pad's model is read from; one that takes its place is another."""
    path = settings.model_path or SHIPPED_MODEL
    with suppress(OSError):
        found = path.stat()
        return path, found.st_ino, found.st_mtime_ns, found.st_size
    return (path,)


def load_model(settings: Settings) -> Classifier:
    """Load the configured model; raises ModelError, or ConfigError when it does not fit the scene."""
    classifier = Classifier.load(settings.model_path or SHIPPED_MODEL)
    check_fit(settings.scene, classifier)
    # The first answer of each length takes several times longer than those after it.
    for frames in settings.scene.answer_at_frames:
        classifier.probabilities(np.zeros((frames, ROWS, COLUMNS), np.float32))
        classifier.step(np.zeros((frames, ROWS, COLUMNS), np.float32))
    return classifier


def load_models(settings: Settings, before: Mapping[str, Pad]) -> dict[str, Classifier]:
    """Load each pad's model, shared by pads with the same file, and with those before; see `load_model`."""
    loaded = {pad.model_file: pad.model for pad in before.values()}
    models: dict[str, Classifier] = {}
    for name, pad in settings.pads.items():
        file = model_file(pad)
        if file in loaded:
            check_fit(pad.scene, loaded[file])
        else:
            loaded[file] = load_model(pad)
        models[name] = loaded[file]
    named = {UNCERTAIN}.union(*(model.labels for model in models.values()))
    if unknown := sorted(set(settings.words) - named):
        raise ConfigError(
            f"words: {unknown[0]} is nothing that is told; name one of {', '.join(sorted(named))}"
        )
    return models


def check_fit(scene: SceneSettings, classifier: Classifier) -> None:
    """Raise ConfigError when a scene asks for gestures or lengths that the model or the scene rules out."""
    known = set(classifier.labels) - {NO_TOUCH}
    acted_on = {gesture for rule in scene.actions for gesture in rule.gestures} - {UNCERTAIN}
    for name, gestures in (("scene.gestures", set(scene.gestures)), ("scene.actions", acted_on)):
        if unknown := sorted(gestures - known):
            raise ConfigError(
                f"{name}: {unknown[0]} is no gesture of the model {classifier.name}; "
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
