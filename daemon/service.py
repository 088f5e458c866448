"""The daemon: from the pads' ports through their pipelines to the sinks, until told to stop."""

from __future__ import annotations

import gc
import itertools
import logging
import threading
import time
import typing
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor

from touchd.daemon.bridges.bridge import Bridge
from touchd.daemon.config import Settings
from touchd.daemon.events import LivePrediction
from touchd.daemon.health import Health
from touchd.daemon.setup.destinations import scenes_of
from touchd.daemon.setup.parts import Pad, Parts
from touchd.daemon.sinks import EventFanout, Sink
from touchd.drivers.frame import Frame
from touchd.drivers.pad.sensor import SensorState
from touchd.drivers.queue import Signal

# How often the loop looks at the stop flag when nothing arrives.
IDLE_S = 0.25
SENSORS_STOP_S = 0.6
DRAIN_S = 2.0
SINKS_STOP_S = 1.2
REPLACED_STOP_S = 1.0
# A reload waits so long for touches to end before the log says so.
PATIENCE_S = 5.0

if typing.TYPE_CHECKING:
    from touchd.daemon.terminal.view import View

log = logging.getLogger(__name__)


class Service:
    """The daemon's loop and its parts. Raises TouchdError when the settings cannot be used."""

    def __init__(self, settings: Settings, health: Health) -> None:
        self._health = health
        self._more_sinks: tuple[Sink, ...] = ()
        self._view: View | None = None
        self._arrived = Signal()
        self._numbers = itertools.count(1)
        self._events = EventFanout()
        self._parts = self._make(settings, None)
        self._pads = dict(self._parts.pads)
        self._next: Parts | None = None
        self._taken_over = threading.Event()
        self._has_ended = False

    def tell(self, sink: Sink) -> None:
        """Hand a sink every event, whatever the configuration; before `run`."""
        self._more_sinks = (*self._more_sinks, sink)

    def show_on(self, view: View) -> None:
        """Show everything on a view, with the frames of the first pad; before `run`."""
        self.tell(view)
        self._view = view

    def run(self, stop: threading.Event) -> None:
        """Run until `stop` is set; then end current touches and stop every sink."""
        # Exempt loaded objects from garbage collection: a full pass takes as long as an answer may.
        gc.freeze()
        self._events.sinks = (*self._parts.sinks, *self._more_sinks)
        for sink in self._events.sinks:
            sink.start()
        for pad in self._pads.values():
            pad.sensor.start()
        took = False
        try:
            while not stop.is_set():
                pads = tuple(self._pads.values())
                if not took and not self._arrived.wait(IDLE_S):
                    self._health.idle()
                # One item of each in turn, so that a pad that floods its queue holds up no other.
                took = self._take(pads)
                self._health.report(self._events.touches, self._dropped())
                if self._next is not None:
                    self._move_on_to(self._next)
        finally:
            self._end()

    def reload(self, settings: Settings) -> list[str]:
        """Swap in parts for other settings, each pad between two touches, while `run` goes on in its thread.

        Returns the names of the settings that changed, when all parts are swapped. No frame and no touch
        number is lost. Raises TouchdError, with nothing changed.
        """
        before = self._parts
        if settings == before.settings and not before.has_other_models:
            return []
        parts = self._make(settings, before)
        readers = [pad.sensor for pad in parts.pads.values()]
        for pad in before.pads.values():
            if pad.sensor not in readers:
                pad.sensor.stop(SENSORS_STOP_S)
                why = "its settings have changed" if pad.name in parts.pads else "it is no longer configured"
                pad.queue.put(SensorState("down", why))
        self._taken_over.clear()
        self._next = parts
        # After clear, so that an end between the two is not missed.
        if self._has_ended:
            return parts.changed
        if not self._taken_over.wait(PATIENCE_S):
            log.info("the new configuration waits for a touch to end")
            self._taken_over.wait()
        if self._has_ended:
            return parts.changed
        # One after the other: the old journal may be the same file.
        _stop([sink for sink in before.sinks if sink not in parts.sinks], REPLACED_STOP_S)
        for sink in parts.sinks:
            if sink not in before.sinks and not self._has_ended:
                sink.start()
        return parts.changed

    def _make(self, settings: Settings, before: Parts | None) -> Parts:
        return Parts(settings, self._events.emit, self._viewers, self._arrived, self._numbers, before)

    def _viewers(self) -> list[Callable[[LivePrediction], None]]:
        """Return the current viewers of live predictions."""
        live, view = self._parts.live, self._view
        return [
            *([live.put] if live is not None and live.is_watched else []),
            *([view.put_live] if view is not None else []),
        ]

    def _move_on_to(self, parts: Parts) -> None:
        """Move each pad that is between two touches to the new parts, then the sinks."""
        for name, pad in list(self._pads.items()):
            new = parts.pads.get(name)
            if new is pad or pad.pipeline.has_touch or (len(pad.queue) and new is None):
                continue
            if new is None:
                del self._pads[name]
                self._health.forget(name)
            else:
                new.go_on_from(pad)
                self._pads[name] = new
                if new.sensor is not pad.sensor:
                    new.sensor.start()
        if any(parts.pads.get(name) is not pad for name, pad in self._pads.items()):
            return
        before, self._parts, self._next = self._parts, parts, None
        for pad in parts.pads.values():
            if pad.name not in self._pads:
                pad.sensor.start()
        self._pads = dict(parts.pads)
        if before.robot not in (None, parts.robot):
            self._events.forget_robot()
        for sink in (parts.robot, parts.live, *parts.bridges.values()):
            if sink is not None and sink not in before.sinks:
                for (_, pad_name), event in list(self._events.standing.items()):
                    if pad_name in ("", *parts.pads):
                        sink.put(event)
        self._events.sinks = (*parts.sinks, *self._more_sinks)
        if parts.live is not None:
            parts.live.put(scenes_of(parts.settings, parts.models))
        logging.getLogger().setLevel(parts.settings.log_level.upper())
        self._taken_over.set()

    def _end(self) -> None:
        self._health.stopping()
        self._has_ended = True
        self._taken_over.set()
        until_s = time.monotonic() + SENSORS_STOP_S
        for pad in self._pads.values():
            pad.sensor.stop(max(0.0, until_s - time.monotonic()))
        # Process frames already queued before flushing; an overloaded machine must not be killed over them.
        until_s = time.monotonic() + DRAIN_S
        for pad in self._pads.values():
            while len(pad.queue) and time.monotonic() < until_s:
                self._take([pad])
            pad.pipeline.flush()
        left = sum(len(pad.queue) for pad in self._pads.values())
        self._health.end(self._events.touches, sum(self._dropped().values()) + left)
        _stop(self._events.sinks, SINKS_STOP_S)

    def _dropped(self) -> dict[str, int]:
        return {name: pad.queue.dropped for name, pad in self._pads.items()}

    def _take(self, pads: Sequence[Pad]) -> bool:
        """Process the oldest thing in each pad's queue; return whether there was any."""
        taken = [(pad, pad.queue.get_nowait()) for pad in pads]
        frames = [(pad, item) for pad, item in taken if isinstance(item, Frame)]
        # Frames go out before the events that they cause.
        if self._parts.kept is not None:
            for pad, frame in frames:
                self._parts.kept.take(frame, pad.name)
        for pad, frame in frames:
            pad.pipeline.on_frame(frame)
            self._pass_on(pad, frame)
        for pad, item in taken:
            if isinstance(item, SensorState):
                pad.pipeline.on_sensor_state(item)
                self._health.pad_state(pad.name, item.state == "up")
        return any(item is not None for _, item in taken)

    def _pass_on(self, pad: Pad, frame: Frame) -> None:
        """Pass on a frame that a pad's pipeline has processed."""
        parts = self._parts
        self._health.frame_processed(pad.name)
        pad.watch.update(frame)
        if self._view is not None and pad.name == next(iter(self._pads)):
            self._view.show_frame(frame.pressure, frame.sensor_ms)
        if parts.live is not None:
            parts.live.put_frame(frame, sum(self._dropped().values()), pad.name)
        for bridge in parts.bridges.values():
            bridge.put_frame(frame, pad.name)


def _stop(sinks: Sequence[Sink], within_s: float) -> None:
    """Stop sinks within that time: one after the other, then the bridges, which may be many, at once."""
    deadline_s = time.monotonic() + within_s
    bridges = [sink for sink in sinks if isinstance(sink, Bridge)]
    others = [sink for sink in sinks if sink not in bridges]
    for left, sink in zip(range(len(others), 0, -1), others, strict=True):
        sink.stop(max(0.0, deadline_s - time.monotonic()) / (left + bool(bridges)))
    with ThreadPoolExecutor(len(bridges) or 1) as ending:
        for bridge in bridges:
            ending.submit(bridge.stop, max(0.0, deadline_s - time.monotonic()))
