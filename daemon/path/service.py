"""The daemon: from the pads' ports through their pipelines to the sinks, until it is asked to stop."""

from __future__ import annotations

import logging
import time
import typing
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor

from touchd.daemon.app.config import Settings
from touchd.daemon.app.parts import PadChannel, make_parts
from touchd.daemon.path.events import LivePrediction
from touchd.daemon.sinks.sink import EventFanout, Sink
from touchd.drivers.faults import FaultLog
from touchd.drivers.frame import Frame, SensorState
from touchd.drivers.queue import Signal

# How often the loop checks the stop flag while nothing arrives.
IDLE_S = 0.25
SENSORS_STOP_S = 0.6
DRAIN_S = 2.0
SINKS_STOP_S = 1.2

if typing.TYPE_CHECKING:
    from touchd.daemon.live.server import LiveServer
    from touchd.daemon.view.view import View

log = logging.getLogger(__name__)


class Service:
    """The daemon's loop and its parts. Raises TouchdError when the settings cannot be used.

    events: passes every event to the sinks. watchers: get every frame.
    """

    def __init__(self, settings: Settings) -> None:
        self._arrived = Signal()
        self._faults = FaultLog(log)
        self.events = EventFanout()
        self.parts = make_parts(settings, self.events.emit, self._viewers, self._arrived)
        self.pads = self.parts.pads
        self.watchers: list[LiveServer | View] = [self.parts.live] if self.parts.live else []

    def add_sink(self, sink: Sink) -> None:
        """Send every event to this sink too, whatever the configuration. Call it before `run`."""
        self.events.sinks += (sink,)

    def run(self, must_stop: Callable[[], bool]) -> None:
        """Run until `must_stop`, asked between items, is True; then end touches and stop every sink."""
        self.events.sinks += self.parts.sinks
        for sink in self.events.sinks:
            sink.start()
        for pad in self.pads:
            pad.sensor.start()
        took = False
        try:
            while not must_stop():
                if not took:
                    self._arrived.wait(IDLE_S)
                # Take one item of each pad in turn: a pad that floods its queue must not hold up the others.
                took = False
                for pad in self.pads:
                    took = self._process_next(pad) or took
        finally:
            self._end()

    def _frames_together(self, pad: PadChannel) -> int:
        """Return how many frames a pad's reader may read at once: one while they are shown to somebody."""
        is_shown = any(bridge.frames_hz is not None for bridge in self.parts.bridges)
        return 1 if is_shown or self._viewers() else pad.pipeline.frames_together

    def _viewers(self) -> list[Callable[[LivePrediction], None]]:
        """Return the current viewers of live predictions."""
        return [each.put for each in self.watchers if each.is_watched]

    def _end(self) -> None:
        until_s = time.monotonic() + SENSORS_STOP_S
        for pad in self.pads:
            pad.sensor.stop(max(0.0, until_s - time.monotonic()))
        # Process queued frames before flushing, but not for so long that an overloaded daemon is killed.
        until_s = time.monotonic() + DRAIN_S
        for pad in self.pads:
            while len(pad.queue) and time.monotonic() < until_s:
                self._process_next(pad)
            pad.pipeline.flush()
        left = sum(len(pad.queue) for pad in self.pads)
        totals = sum(pad.frames for pad in self.pads), self.events.touches, self._dropped() + left
        log.info("%d frames, %d touches, %d frames dropped in all", *totals)
        self._stop_sinks()

    def _dropped(self) -> int:
        return sum(pad.queue.dropped for pad in self.pads)

    def _process_next(self, pad: PadChannel) -> bool:
        """Process the oldest item in a pad's queue; return whether there was one."""
        item = pad.queue.get_nowait()
        if isinstance(item, Frame):
            # The touch sink must get a frame before the events that it causes.
            if self.parts.touches is not None:
                self.parts.touches.put_frame(item, pad.name)
            pad.pipeline.on_frame(item)
            pad.frames += 1
            self._show(pad, item)
            if not len(pad.queue):
                pad.sensor.frames_together = self._frames_together(pad)
            if dropped := pad.queue.dropped:
                why = "the machine is too busy, or the pad sends too many"
                over = f"{pad.name}: no frames are dropped any more; {dropped} were"
                self._faults.count(pad.name, dropped, f"{pad.name}: frames dropped: {why}", over)
        elif isinstance(item, SensorState):
            pad.pipeline.on_sensor_state(item)
            pad.is_up = item.state == "up"
        return item is not None

    def _show(self, pad: PadChannel, frame: Frame) -> None:
        """Pass a processed frame to the page, the terminal view and the bridges."""
        for each in self.watchers:
            each.put_frame(frame, self._dropped(), pad.name)
        for bridge in self.parts.bridges:
            bridge.put_frame(frame, pad.name)

    def _stop_sinks(self) -> None:
        """Stop the last sink first, the robot, which emits events of its own; then the others in parallel."""
        sinks = self.events.sinks
        for robot in sinks[-1:]:
            robot.stop(SINKS_STOP_S / 2)
        with ThreadPoolExecutor(len(sinks) or 1) as ending:
            for sink in sinks[:-1]:
                ending.submit(sink.stop, SINKS_STOP_S / 2)
