"""The daemon: from the pads' ports through their pipelines to the sinks, until told to stop."""

from __future__ import annotations

import gc
import logging
import threading
import time
from collections.abc import Callable

import numpy as np

from daemon.bridges.bridges import Bridges
from daemon.config import ConfigError, SceneSettings, Settings
from daemon.decide import NO_TOUCH
from daemon.destinations import link_to_robot, open_journal, open_touch_stores, parser_for
from daemon.events import UNCERTAIN, Event, LivePrediction, TouchBegan
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

# Poll interval for the stop flag while no frames arrive, which also bounds an idle daemon's wake-ups.
IDLE_S = 0.25
SENSORS_STOP_S = 0.6
SINKS_STOP_S = 1.2


class Outlet:
    """Hands every event to every sink, from whichever thread it comes; no sink makes it wait.

    Journal, robot, live page, kept touches and bridges are always among them, and do nothing where not
    configured.
    """

    def __init__(self, settings: Settings) -> None:
        self.journal = JournalSink(open_journal(settings.journal))
        self.robot = RobotSink(None)
        self.live = LiveSink()
        self.kept = TouchSink(open_touch_stores(settings))
        self.bridges = Bridges()
        self.sinks: list[Sink] = [self.journal, self.robot, self.live, self.kept, self.bridges]
        self.shows: list[Callable[[LivePrediction], None]] = [self.live.put_live]
        self.touches = 0

    def emit(self, event: Event) -> None:
        """Hand an event over."""
        self.touches += isinstance(event, TouchBegan)
        for sink in self.sinks:
            sink.put(event)

    def show(self, frame: Frame, dropped: int, pad: str) -> None:
        """Hand a pad's frame to the sinks that show it, and how many the daemon was too slow for so far."""
        self.live.put_frame(frame, dropped, pad)
        self.bridges.put_frame(frame, pad)

    def show_live(self, prediction: LivePrediction) -> None:
        """Show what the model makes of a touch to whoever looks."""
        for show in self.shows:
            show(prediction)

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


def load_models(settings: Settings) -> dict[str, Classifier]:
    """Load each pad's model; pads with the same file share it. Raises as `load_model` does."""
    models: dict[str, Classifier] = {}
    loaded: dict[str | None, Classifier] = {}
    for name, pad in settings.pads.items():
        if pad.model in loaded:
            check_fit(pad.scene, loaded[pad.model])
        else:
            loaded[pad.model] = load_model(pad)
        models[name] = loaded[pad.model]
    return models


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
    """Raise SensorError when the only port can never work as it is.

    One that is not there, not permitted or busy is waited for: udev and other programs may be late at boot.
    One of several pads that cannot work must not keep the others from it; its events say why.
    """
    if settings.sensors:
        return
    try:
        check_port(settings.sensor.port, settings.sensor.baud)
    except SensorError as error:
        if error.kind == "unusable":
            raise


class Pad:
    """One pad: its reader, the queue that this fills, and the pipeline that makes events of what is in it.

    settings: those of this pad. arrived: notified whenever something waits in the queue.
    """

    def __init__(
        self,
        name: str,
        settings: Settings,
        model: Classifier,
        outlet: Outlet,
        arrived: threading.Condition,
    ) -> None:
        self.name = name
        self.settings = settings
        self.queue = FrameQueue(filled=arrived)
        self.pipeline = Pipeline(settings.pipeline, model, outlet.emit, pad=name, show=outlet.show_live)
        self.watch = PadWatch(name)
        self._sensor = self._reader()

    def start(self) -> None:
        """Begin to read."""
        self._sensor.start()

    def change(self, settings: Settings, model: Classifier) -> None:
        """Go by other settings; another port is read from now on, all else counts from the next touch on."""
        before, self.settings = self.settings, settings
        self.pipeline.change(settings.pipeline, model)
        if settings.sensor == before.sensor:
            return
        self.stop(SENSORS_STOP_S)
        self.queue.put(SensorState("down", f"now {settings.sensor.port} is read, as configured"))
        self._sensor = self._reader()
        self._sensor.start()

    def stop(self, timeout_s: float) -> None:
        """End reading."""
        self._sensor.stop(timeout_s)

    def _reader(self) -> Sensor:
        sensor = self.settings.sensor
        return Sensor(sensor.port, sensor.baud, parser_for(sensor), self.queue)


class Service:
    """The daemon's loop and all that it joins.

    models: for each pad. show_frame: gets the counts and the clock of each frame of the first pad.
    """

    def __init__(
        self,
        settings: Settings,
        models: dict[str, Classifier],
        outlet: Outlet,
        health: Health,
        show_frame: Callable[[Counts, int], None] | None = None,
    ) -> None:
        self._settings = settings
        self._models = models
        self._outlet = outlet
        self._health = health
        self._show_frame = show_frame
        self._arrived = threading.Condition()
        self._pads = [
            Pad(name, pad, models[name], outlet, self._arrived) for name, pad in settings.pads.items()
        ]

    def run(self, stop: threading.Event) -> None:
        """Run until `stop` is set; then no pad is read any more and the touches that went on have ended."""
        # What was loaded stays: a collection that looks through it all would take as long as an answer may.
        gc.freeze()
        for pad in self._pads:
            pad.start()
        try:
            while not stop.is_set():
                with self._arrived:
                    if not self._arrived.wait_for(self._waiting, IDLE_S):
                        self._health.idle()
                # One item of each in turn, so that a pad that floods its queue holds up no other.
                for pad in self._pads:
                    self._take(pad)
                self._health.report(self._outlet.touches, self._dropped())
        finally:
            until_s = time.monotonic() + SENSORS_STOP_S
            for pad in self._pads:
                pad.stop(max(0.0, until_s - time.monotonic()))
            # Process frames already queued before flushing.
            for pad in self._pads:
                for _ in range(len(pad.queue)):
                    self._take(pad)
                pad.pipeline.flush()
            self._health.end(self._outlet.touches, self._dropped())

    def change(self, settings: Settings) -> list[str]:
        """Go by other settings, while `run` goes on in another thread; returns the names of what changed.

        Touch, ring, scene and model count from the next touch on. Raises TouchdError when the settings cannot
        be used; then nothing has changed.
        """
        before, pads = self._settings, settings.pads
        fields = Settings.__struct_fields__
        names = [name for name in fields if getattr(before, name) != getattr(settings, name)]
        changed = set(names)
        if list(pads) != [pad.name for pad in self._pads]:
            raise ConfigError("sensors: other pads than before; restart touchd to have them read")
        models = load_models(settings) if changed & {"model", "sensors"} else self._models
        for name, pad in pads.items():
            check_fit(pad.scene, models[name])
        if settings.sensor.port != before.sensor.port:
            check_pad(settings)
        is_told_otherwise = bool(changed & {"robot", "sensors", "language", "words"})
        tells_anew = is_told_otherwise or settings.scene.actions != before.scene.actions
        link = link_to_robot(settings, self._outlet.emit) if tells_anew else None
        keeps_anew = bool(changed & {"journal", "sensor", "sensors"})
        stores = open_touch_stores(settings) if keeps_anew else {}
        try:
            self._outlet.live.use(settings, models)
            self._outlet.bridges.use(settings, models)
            # Last, since it is the one that leaves something behind; nothing after it fails.
            journal = open_journal(settings.journal) if "journal" in names else None
        except TouchdError:
            self._outlet.live.use(before, self._models)
            self._outlet.bridges.use(before, self._models)
            raise
        self._settings, self._models = settings, models
        logging.getLogger().setLevel(settings.log_level.upper())
        if "journal" in names:
            self._outlet.journal.use(journal)
        if keeps_anew:
            self._outlet.kept.use(stores)
        if tells_anew:
            self._outlet.robot.use(link)
        for pad_line in self._pads:
            pad_line.change(pads[pad_line.name], models[pad_line.name])
        return names

    def _waiting(self) -> bool:
        return any(len(pad.queue) for pad in self._pads)

    def _dropped(self) -> int:
        return sum(pad.queue.dropped for pad in self._pads)

    def _take(self, pad: Pad) -> None:
        match pad.queue.get(timeout_s=0):
            case Frame() as frame:
                # Before the events that it causes.
                self._outlet.kept.take(frame, pad.name)
                pad.pipeline.on_frame(frame)
                self._health.frame_processed(pad.name)
                pad.watch.update(frame)
                if self._show_frame is not None and pad is self._pads[0]:
                    self._show_frame(frame.pressure, frame.sensor_ms)
                self._outlet.show(frame, self._dropped(), pad.name)
            case SensorState() as state:
                pad.pipeline.on_sensor_state(state)
                self._health.pad_state(pad.name, state.state == "up")
