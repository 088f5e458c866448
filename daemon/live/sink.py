"""The live page as the daemon sees it: always among the sinks, and doing nothing where none is asked for."""

from __future__ import annotations

import logging
import typing
from collections.abc import Mapping

from daemon.config import LiveSettings, Settings
from daemon.decide import ProbabilityModel
from daemon.events import Event, LivePrediction, RobotEvent, SensorEvent
from daemon.live.address import LiveError, listen, require_library, urls_of
from daemon.live.memory import Scene
from drivers.frame import DEFAULT_PAD, Frame

if typing.TYPE_CHECKING:
    from daemon.live.server import LiveServer

log = logging.getLogger(__name__)

STOP_S = 1.0


class LiveSink:
    """Hands events and frames to the page's server, if there is one."""

    name = "live"

    def __init__(self) -> None:
        self._settings: LiveSettings | None = None
        self._server: LiveServer | None = None
        self._standing: dict[tuple[type[Event], str], Event] = {}
        self._dropped_before = 0

    def use(self, settings: Settings, models: Mapping[str, ProbabilityModel]) -> None:
        """Serve the page as these settings say from now on, if they ask for one; from any thread.

        Raises LiveError when it cannot be served so; then it is served as before.
        """
        scenes = {
            name: Scene(pad.pipeline, models[name], settings.robot is not None)
            for name, pad in settings.pads.items()
        }
        if settings.live == self._settings:
            if self._server is not None:
                self._server.put(scenes)
            return
        # First, for the new one may listen at the same port of more addresses.
        self.stop(STOP_S)
        try:
            self._serve(settings.live, scenes)
        except LiveError:
            self._serve(self._settings, scenes)
            raise
        self._settings = settings.live

    @property
    def dropped(self) -> int:
        """Events and frames that the page's own thread was too slow for; slow viewers do not count."""
        return self._dropped_before + (self._server.dropped if self._server is not None else 0)

    def put(self, event: Event) -> None:
        """Show an event; returns at once."""
        if isinstance(event, SensorEvent | RobotEvent):
            self._standing[type(event), getattr(event, "pad", "")] = event
        server = self._server
        if server is not None:
            server.put(event)

    def put_live(self, prediction: LivePrediction) -> None:
        """Show what the model makes of the touch at this moment; returns at once."""
        server = self._server
        if server is not None:
            server.put(prediction)

    def put_frame(self, frame: Frame, dropped: int, pad: str = DEFAULT_PAD) -> None:
        """Show a pad's frame, and how many the daemon was too slow for so far; returns at once."""
        server = self._server
        if server is not None:
            server.put_frame(frame, dropped, pad)

    def stop(self, timeout_s: float) -> None:
        """Say goodbye to all who look, and stop listening."""
        server, self._server = self._server, None
        if server is not None:
            server.stop(timeout_s)
            self._dropped_before += server.dropped

    def _serve(self, settings: LiveSettings | None, scenes: Mapping[str, Scene]) -> None:
        if settings is None:
            return
        require_library()
        from daemon.live.server import LiveServer

        listening = listen(settings)
        log.info("live page: %s", " ".join(urls_of(settings, listening.getsockname()[1])))
        server = LiveServer(listening, settings, scenes)
        self._server = server
        for event in list(self._standing.values()):
            server.put(event)
