"""The configured bridges of every pad, as one sink."""

from __future__ import annotations

import importlib
import time
from collections.abc import Callable, Mapping, Sequence

from daemon.bridges.bridge import Bridge, BridgeError
from daemon.bridges.settings import Section
from daemon.config import SceneSettings, Settings
from daemon.decide import NO_TOUCH, ProbabilityModel
from daemon.events import Event, RobotEvent, SensorEvent
from drivers.extras import how_to_install
from drivers.frame import Frame

STOP_S = 1.0

Key = tuple[str, str]


class Bridges:
    """Hands a pad's events and frames to its bridges; opened anew when their settings change."""

    name = "bridges"

    def __init__(self) -> None:
        self._sections: dict[Key, tuple[Section, tuple[str, ...]]] = {}
        self._bridges: dict[Key, Bridge] = {}
        self._standing: dict[tuple[type[Event], str], Event] = {}
        self._dropped_before = 0

    def start(self) -> None:
        """Nothing is to be begun: each bridge is once it is used."""

    def use(self, settings: Settings, models: Mapping[str, ProbabilityModel]) -> None:
        """Have one bridge for each pad and each section that is set, from now on; from any thread.

        models: for each pad. Raises BridgeError when a bridge cannot be used so; then nothing has changed.
        """
        wanted = {
            (name, pad): (section, _gestures(own.scene, models[pad]))
            for name, section in settings.bridges.items()
            if section is not None
            for pad, own in settings.pads.items()
        }
        new = {key: value for key, value in wanted.items() if self._sections.get(key) != value}
        prepared = {key: _prepare(*key, *value) for key, value in new.items()}
        bridges = dict(self._bridges)
        ended = [bridges.pop(key) for key in self._bridges if key in new or key not in wanted]
        self._bridges = bridges
        # The old one leaves before the new one comes: to its peer they are the same.
        self._end(ended, STOP_S)
        self._dropped_before += sum(bridge.dropped for bridge in ended)
        self._sections = wanted
        opened = {key: open_bridge() for key, open_bridge in prepared.items()}
        for (_, pad), bridge in opened.items():
            for event in list(self._standing.values()):
                if _pad_of(event) in (pad, None):
                    bridge.put(event)
        self._bridges = bridges | opened

    @property
    def dropped(self) -> int:
        """Events and frames that a bridge was too slow for."""
        return self._dropped_before + sum(bridge.dropped for bridge in list(self._bridges.values()))

    def put(self, event: Event) -> None:
        """Pass on an event of a pad, or one of the robot to all; returns at once."""
        of = _pad_of(event)
        if isinstance(event, SensorEvent | RobotEvent):
            self._standing[type(event), of or ""] = event
        for (_, pad), bridge in list(self._bridges.items()):
            if of in (pad, None):
                bridge.put(event)

    def put_frame(self, frame: Frame, of: str) -> None:
        """Pass on a frame of a pad; returns at once."""
        for (_, pad), bridge in list(self._bridges.items()):
            if pad == of:
                bridge.put_frame(frame)

    def stop(self, timeout_s: float) -> None:
        """Pass on what is queued, as far as the time allows, and end; may be repeated."""
        self._end(list(self._bridges.values()), timeout_s)

    @staticmethod
    def _end(bridges: Sequence[Bridge], timeout_s: float) -> None:
        deadline_s = time.monotonic() + timeout_s
        for waiting, bridge in zip(range(len(bridges), 0, -1), bridges, strict=True):
            bridge.stop(max(0.0, deadline_s - time.monotonic()) / waiting)


def _prepare(name: str, pad: str, section: Section, labels: tuple[str, ...]) -> Callable[[], Bridge]:
    try:
        module = importlib.import_module(f"daemon.bridges.{name}")
    except ImportError as error:
        raise BridgeError(f"{name}: {error.name} is not installed: {how_to_install(name)}") from error
    opener: Callable[[], Bridge] = module.prepare(section, pad, labels)
    return opener


def _gestures(scene: SceneSettings, model: ProbabilityModel) -> tuple[str, ...]:
    """Return what can be told of a pad."""
    return tuple(scene.gestures or (label for label in model.labels if label != NO_TOUCH))


def _pad_of(event: Event) -> str | None:
    """Return the name of the pad that an event is about, None for one of the robot."""
    return None if isinstance(event, RobotEvent) else event.pad
