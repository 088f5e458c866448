"""The daemon: from the pad's port through the pipeline to the sinks, until told to stop."""

from __future__ import annotations

import gc
import logging
import threading
import time
from collections.abc import Callable

import numpy as np

from daemon.config import ConfigError, SceneSettings, SensorSettings, Settings
from daemon.decide import NO_TOUCH
from daemon.destinations import link_to_robot, open_journal, open_touch_store, parser_for
from daemon.events import UNCERTAIN, Event, TouchBegan
from daemon.health import Health
from daemon.kept.touch_sink import TouchSink
from daemon.live.sink import LiveSink
from daemon.pipeline import Pipeline
from daemon.sinks import JournalSink, RobotSink, Sink
from drivers.errors import TouchdError
from drivers.frame import COLUMNS, ROWS, Counts, Frame
from drivers.pad.sensor import FrameQueue, Sensor, SensorError, SensorState, check_port
from drivers.pad.watch import PadWatch
from model.classifier import SHIPPED_MODEL, Classifier

# How often a loop without frames looks whether it shall stop, which also bounds an idle daemon's wake-ups.
IDLE_S = 0.25
SENSOR_STOP_S = 0.6
SINKS_STOP_S = 1.2


class Outlet:
    """Hands every event to every sink, from whichever thread it comes; no sink makes it wait.

    Journal, robot, live page and kept touches are always among them, and do nothing where not configured.
    """

    def __init__(self, settings: Settings) -> None:
        self.journal = JournalSink(open_journal(settings.journal))
        self.robot = RobotSink(None)
        self.live = LiveSink()
        self.kept = TouchSink(open_touch_store(settings))
        self.sinks: list[Sink] = [self.journal, self.robot, self.live, self.kept]
        self.touches = 0

    def emit(self, event: Event) -> None:
        """Hand an event over."""
        self.touches += isinstance(event, TouchBegan)
        for sink in self.sinks:
            sink.put(event)

    def stop(self) -> None:
        """Stop every sink, all of them within SINKS_STOP_S."""
        deadline_s = time.monotonic() + SINKS_STOP_S
        for waiting, sink in zip(range(len(self.sinks), 0, -1), self.sinks, strict=True):
            sink.stop(max(0.0, deadline_s - time.monotonic()) / waiting)


def load_model(settings: Settings) -> Classifier:
    """Load the configured model; raises ModelError, or ConfigError when it does not fit the scene."""
    classifier = Classifier.load(settings.model_path or SHIPPED_MODEL)
    check_fit(settings.scene, classifier)
    # The first answer of each length takes several times longer than those after it.
    for frames in settings.scene.answer_at_frames:
        classifier.probabilities(np.zeros((frames, ROWS, COLUMNS), np.float32))
    return classifier


def check_fit(scene: SceneSettings, classifier: Classifier) -> None:
    """Raise ConfigError when a scene asks for gestures or lengths that the model does not have."""
    known = set(classifier.labels)
    acted_on = {gesture for rule in scene.actions for gesture in rule.gestures} - {UNCERTAIN}
    for name, gestures in (("scene.gestures", set(scene.gestures)), ("scene.actions", acted_on)):
        if unknown := sorted(gestures - known):
            raise ConfigError(
                f"{name}: {unknown[0]} is no gesture of the model {classifier.name}; "
                f"it knows {', '.join(sorted(known - {NO_TOUCH}))}"
            )
    longest = classifier.metadata.max_length
    if scene.answer_at_frames[-1] > longest:
        raise ConfigError(
            f"scene.answer_at_frames: {scene.answer_at_frames[-1]} is more than "
            f"the {longest} frames that the model {classifier.name} takes"
        )


def check_pad(settings: Settings) -> None:
    """Raise SensorError when the port can never work as it is.

    One that is not there, not permitted or busy is waited for: udev and other programs may be late at boot.
    """
    try:
        check_port(settings.sensor.port, settings.sensor.baud)
    except SensorError as error:
        if error.kind == "unusable":
            raise


class Pad:
    """The reader of the configured pad, and the queue that it fills."""

    def __init__(self, settings: SensorSettings) -> None:
        self.queue = FrameQueue()
        self._sensor = self._reader(settings)

    def start(self) -> None:
        """Begin to read."""
        self._sensor.start()

    def change(self, settings: SensorSettings) -> None:
        """Read another pad, or the same in another way; what was read before stays in the queue."""
        self.stop()
        self.queue.put(SensorState("down", f"now {settings.port} is read, as configured"))
        self._sensor = self._reader(settings)
        self._sensor.start()

    def stop(self) -> None:
        """End reading, within SENSOR_STOP_S."""
        self._sensor.stop(SENSOR_STOP_S)

    def _reader(self, settings: SensorSettings) -> Sensor:
        return Sensor(settings.port, settings.baud, parser_for(settings), self.queue)


class Service:
    """The daemon's loop and all that it joins.

    show_frame: gets each frame.
    """

    def __init__(
        self,
        settings: Settings,
        classifier: Classifier,
        outlet: Outlet,
        health: Health,
        show_frame: Callable[[Counts], None] | None = None,
    ) -> None:
        self._settings = settings
        self._classifier = classifier
        self._outlet = outlet
        self._health = health
        self._show_frame = show_frame
        self._pad = Pad(settings.sensor)
        self._pad_watch = PadWatch()
        self._pipeline = Pipeline(settings.pipeline, classifier, outlet.emit)

    def run(self, stop: threading.Event) -> None:
        """Run until `stop` is set; then the pad is no longer read and the touch that went on has ended."""
        # What was loaded stays: a collection that looks through it all would take as long as an answer may.
        gc.freeze()
        self._pad.start()
        try:
            while not stop.is_set():
                self._take(self._pad.queue.get(timeout_s=IDLE_S))
                self._health.report(self._outlet.touches, self._pad.queue.dropped)
        finally:
            self._pad.stop()
            # What had arrived was felt.
            for _ in range(len(self._pad.queue)):
                self._take(self._pad.queue.get(timeout_s=0))
            self._pipeline.flush()
            self._health.end(self._outlet.touches, self._pad.queue.dropped)

    def change(self, settings: Settings) -> list[str]:
        """Go by other settings, while `run` goes on in another thread; returns the names of what changed.

        Touch, ring, scene and model count from the next touch on. Raises TouchdError when the settings cannot
        be used; then nothing has changed.
        """
        before = self._settings
        fields = Settings.__struct_fields__
        names = [name for name in fields if getattr(before, name) != getattr(settings, name)]
        classifier = load_model(settings) if "model" in names else self._classifier
        check_fit(settings.scene, classifier)
        if settings.sensor.port != before.sensor.port:
            check_pad(settings)
        tells_anew = "robot" in names or settings.scene.actions != before.scene.actions
        link = link_to_robot(settings.robot, settings.scene, self._outlet.emit) if tells_anew else None
        keeps_anew = bool({"journal", "sensor"} & set(names))
        store = open_touch_store(settings) if keeps_anew else None
        self._outlet.live.use(settings, classifier)
        # Last, since it is the one that leaves something behind; nothing after it fails.
        try:
            journal = open_journal(settings.journal) if "journal" in names else None
        except TouchdError:
            self._outlet.live.use(before, self._classifier)
            raise
        self._settings, self._classifier = settings, classifier
        logging.getLogger().setLevel(settings.log_level.upper())
        if {"touch", "ring", "scene", "model"} & set(names):
            self._pipeline.change(settings.pipeline, classifier)
        if "journal" in names:
            self._outlet.journal.use(journal)
        if keeps_anew:
            self._outlet.kept.use(store)
        if tells_anew:
            self._outlet.robot.use(link)
        if "sensor" in names:
            self._pad.change(settings.sensor)
        return names

    def _take(self, item: Frame | SensorState | None) -> None:
        match item:
            case Frame() as frame:
                # Before the events that it causes.
                self._outlet.kept.take(frame)
                self._pipeline.on_frame(frame)
                self._health.frame_processed()
                self._pad_watch.update(frame)
                if self._show_frame is not None:
                    self._show_frame(frame.pressure)
                self._outlet.live.put_frame(frame, self._pad.queue.dropped)
            case SensorState() as state:
                self._pipeline.on_sensor_state(state)
                self._health.pad_state(state.state == "up")
            case None:
                self._health.idle()
