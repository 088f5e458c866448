"""The daemon: from the pads' ports through their pipelines to the sinks, until it is asked to stop."""

from __future__ import annotations

import gc
import logging
import time
import typing
from collections.abc import Callable, Mapping
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from pathlib import Path

from touchd.daemon.config import Settings
from touchd.daemon.events import LivePrediction
from touchd.daemon.parts import PadChannel, make_parts
from touchd.daemon.sinks import EventFanout, Sink
from touchd.drivers.frame import Frame, SensorState
from touchd.drivers.queue import Signal

# How often the loop looks at the stop flag when nothing arrives.
IDLE_S = 0.25
SENSORS_STOP_S = 0.6
DRAIN_S = 2.0
SINKS_STOP_S = 1.2
# How often it is logged that frames were dropped.
DROPPED_EVERY_S = 5.0

if typing.TYPE_CHECKING:
    from touchd.daemon.systemd import Health
    from touchd.daemon.terminal.view import View

log = logging.getLogger(__name__)


class Service:
    """The daemon's loop and its parts. Raises TouchdError when the settings cannot be used.

    config: the file of the settings. health: what is reported to systemd, if it started the daemon.
    events: where all of them pass through.
    """

    def __init__(self, settings: Settings, config: Path | None = None, health: Health | None = None) -> None:
        self._settings = settings
        self._health = health
        self._view: View | None = None
        self._arrived = Signal()
        self._frames = 0
        self._drops = DropLog()
        self.events = EventFanout()
        self._parts = make_parts(settings, self.events.emit, self._viewers, self._arrived, config)

    def tell(self, sink: Sink) -> None:
        """Send every event to this sink too, whatever the configuration. Call it before `run`."""
        self.events.sinks += (sink,)

    def show_on(self, view: View) -> None:
        """Show everything on a view, with the frames of the first pad. Call it before `run`."""
        self.tell(view)
        self._view = view
        from touchd.daemon.labels import make_labeller

        models = {pad.name: pad.model for pad in self._parts.pads}
        view.labeller = self._parts.labeller or make_labeller(self._settings, models, self.events.emit)

    def run(self, must_stop: Callable[[], bool]) -> None:
        """Run until `must_stop` returns True; then end current touches and stop every sink."""
        # Exempt loaded objects from garbage collection: a full pass takes as long as an answer may.
        gc.freeze()
        self.events.sinks += self._parts.sinks
        for sink in self.events.sinks:
            sink.start()
        for pad in self._parts.pads:
            pad.sensor.start(partial(self._frames_together, pad))
        took = False
        try:
            while not must_stop():
                if not took and not self._arrived.wait(IDLE_S) and self._health is not None:
                    self._health.feed()
                # Take one item of each pad in turn: a pad that floods its queue must not hold up the others.
                took = False
                for pad in self._parts.pads:
                    took = self._process_next(pad) or took
                dropped = {pad.name: pad.queue.dropped for pad in self._parts.pads}
                self._drops.update(dropped)
                if self._health is not None:
                    self._health.report(self.events.touches, sum(dropped.values()))
        finally:
            self._end()

    def _frames_together(self, pad: PadChannel) -> int:
        """How many of a pad's next frames may be read at once: one while somebody is shown them."""
        is_shown = any(bridge.frames_hz is not None for bridge in self._parts.bridges)
        return 1 if is_shown or self._viewers() else pad.pipeline.frames_together

    def _viewers(self) -> list[Callable[[LivePrediction], None]]:
        """Return the current viewers of live predictions."""
        live, view = self._parts.live, self._view
        return [
            *([live.put] if live is not None and live.is_watched else []),
            *([view.put_live] if view is not None else []),
        ]

    def _end(self) -> None:
        if self._health is not None:
            self._health.stopping()
        until_s = time.monotonic() + SENSORS_STOP_S
        for pad in self._parts.pads:
            pad.sensor.stop(max(0.0, until_s - time.monotonic()))
        # Process queued frames before flushing, but not for so long that an overloaded daemon is killed.
        until_s = time.monotonic() + DRAIN_S
        for pad in self._parts.pads:
            while len(pad.queue) and time.monotonic() < until_s:
                self._process_next(pad)
            pad.pipeline.flush()
        left = sum(len(pad.queue) for pad in self._parts.pads)
        totals = self._frames, self.events.touches, self._dropped() + left
        log.info("%d frames, %d touches, %d frames dropped in all", *totals)
        self._stop_sinks()

    def _dropped(self) -> int:
        return sum(pad.queue.dropped for pad in self._parts.pads)

    def _process_next(self, pad: PadChannel) -> bool:
        """Process the oldest item in a pad's queue; return whether there was one."""
        item = pad.queue.get_nowait()
        if isinstance(item, Frame):
            # The store must get a frame before the events that it causes.
            if self._parts.kept is not None:
                self._parts.kept.put_frame(item, pad.name)
            pad.pipeline.on_frame(item)
            self._frames += 1
            if self._health is not None:
                self._health.frame_processed(pad.name)
            self._show(pad, item)
        elif isinstance(item, SensorState):
            pad.pipeline.on_sensor_state(item)
            if self._health is not None:
                self._health.pad_state(pad.name, item.state == "up")
        return item is not None

    def _show(self, pad: PadChannel, frame: Frame) -> None:
        """Hand a processed frame to everything that shows or checks frames."""
        parts = self._parts
        if self._view is not None and pad is parts.pads[0]:
            self._view.show_frame(frame.pressure, frame.sensor_ms)
        if parts.live is not None:
            parts.live.put_frame(frame, self._dropped(), pad.name)
        for bridge in parts.bridges:
            bridge.put_frame(frame, pad.name)

    def _stop_sinks(self) -> None:
        """Stop sinks within SINKS_STOP_S: the robot first, then the others, then all bridges in parallel."""
        deadline_s = time.monotonic() + SINKS_STOP_S
        bridges = self._parts.bridges
        others = [sink for sink in reversed(self.events.sinks) if sink not in bridges]
        for left, sink in zip(range(len(others), 0, -1), others, strict=True):
            sink.stop(max(0.0, deadline_s - time.monotonic()) / (left + bool(bridges)))
        with ThreadPoolExecutor(len(bridges) or 1) as ending:
            for bridge in bridges:
                ending.submit(bridge.stop, max(0.0, deadline_s - time.monotonic()))


class DropLog:
    """Logs every DROPPED_EVERY_S how many frames the pads' full queues have dropped."""

    def __init__(self) -> None:
        self._before: Mapping[str, int] = {}
        self._logged_s = time.monotonic()

    def update(self, dropped: Mapping[str, int]) -> None:
        """Take how many frames of each pad were dropped so far."""
        now_s = time.monotonic()
        if now_s - self._logged_s < DROPPED_EVERY_S:
            return
        for pad, count in dropped.items():
            if (newly := count - self._before.get(pad, 0)) > 0:
                why = "the machine is too busy, or the pad sends too many"
                log.warning("%s: %d frames dropped: %s", pad, newly, why)
        self._before, self._logged_s = dropped, now_s
