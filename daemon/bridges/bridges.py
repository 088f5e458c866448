"""Makes the bridges that are configured: for each section one a pad, or one process for all pads."""

import importlib.util
from collections.abc import Mapping

from touchd.daemon.bridges.bridge import Bridge, BridgeError, bridge_class
from touchd.daemon.bridges.settings import LslSettings, Ros2Settings, Section
from touchd.daemon.config import Settings
from touchd.drivers.frame import NO_TOUCH
from touchd.drivers.installed import EXTRAS, how_to_install
from touchd.model.classifier import Classifier


def make_bridges(settings: Settings, models: Mapping[str, Classifier]) -> list[Bridge]:
    """Return the configured bridges, not yet started.

    models: the model of each pad. Raises BridgeError when a bridge cannot be used as configured.
    """
    bridges: list[Bridge] = []
    for name, section in settings.bridges.items():
        if isinstance(section, LslSettings | Ros2Settings):
            bridges.append(_make(name, section, tuple(settings.pads), ()))
        elif section is not None:
            bridges += [
                _make(name, section, (pad,), own.scene.gestures or _touches(models[pad]))
                for pad, own in settings.pads.items()
            ]
    return bridges


def _make(name: str, section: Section, pads: tuple[str, ...], gestures: tuple[str, ...]) -> Bridge:
    for library in EXTRAS[name]:
        if importlib.util.find_spec(library) is None:
            raise BridgeError(f"{name}: {library} is not installed: {how_to_install(name)}")
    if isinstance(section, LslSettings | Ros2Settings):
        from touchd.daemon.bridges.apart import ApartBridge

        return ApartBridge(name, section, pads)
    bridge: Bridge = bridge_class(name)(section, *pads, gestures)
    return bridge


def _touches(model: Classifier) -> tuple[str, ...]:
    return tuple(label for label in model.labels if label != NO_TOUCH)
