"""The daemon: from the pad's port through the pipeline to the sinks, until told to stop."""

from __future__ import annotations

import gc
import logging
import threading
import time
from collections.abc import Callable

import numpy as np

from daemon.config import ConfigError, SceneSettings, Settings
from daemon.decide import NO_TOUCH
from daemon.events import UNCERTAIN, Event, TouchBegan
from daemon.health import Health
from daemon.pad_watch import PadWatch
from daemon.pipeline import Pipeline
from daemon.sinks import Sink
from daemon.wire import parser_for
from drivers.frame import COLUMNS, ROWS, Counts, Frame
from drivers.sensor import FrameQueue, Sensor, SensorError, SensorState, check_port
from model.classifier import SHIPPED_MODEL, Classifier

log = logging.getLogger(__name__)

# How often a loop without frames looks whether it shall stop, which also bounds an idle daemon's wake-ups.
IDLE_S = 0.25
SENSOR_STOP_S = 0.6
SINKS_STOP_S = 1.2


class Outlet:
    """Hands every event to every sink, from whichever thread it comes; no sink makes it wait."""

    def __init__(self) -> None:
        self.sinks: list[Sink] = []
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
    """Raise SensorError when the port can never work as it is; one that is not there yet is waited for."""
    try:
        check_port(settings.sensor.port, settings.sensor.baud)
    except SensorError as error:
        if error.kind != "missing":
            raise


def serve(
    settings: Settings,
    classifier: Classifier,
    outlet: Outlet,
    health: Health,
    stop: threading.Event,
    show_frame: Callable[[Counts], None] | None = None,
) -> None:
    """Run until `stop` is set; then every thread that this began has ended. show_frame: gets each frame."""
    queue = FrameQueue()
    sensor = Sensor(settings.sensor.port, settings.sensor.baud, parser_for(settings.sensor), queue)
    pipeline = Pipeline(settings.pipeline, classifier, outlet.emit)
    pad_watch = PadWatch()
    # What was loaded stays: a collection that looks through all of it would take as long as an answer may.
    gc.freeze()
    sensor.start()
    try:
        while not stop.is_set():
            match queue.get(timeout_s=IDLE_S):
                case Frame() as frame:
                    pipeline.on_frame(frame)
                    health.frame_processed()
                    pad_watch.update(frame)
                    if show_frame is not None:
                        show_frame(frame.pressure)
                case SensorState() as state:
                    pipeline.on_sensor_state(state)
                    health.pad_state(state.state == "up")
                case None:
                    health.idle()
            health.report(outlet.touches, queue.dropped)
    finally:
        sensor.stop(SENSOR_STOP_S)
        pipeline.flush()
