"""From the settings to the bridges: for each section that is set one a pad, or one process for all pads."""

import importlib
import importlib.util
from collections.abc import Mapping

from touchd.daemon.bridges.bridge import Bridge, BridgeError
from touchd.daemon.bridges.settings import LslSettings, MqttSettings, Ros2Settings, Section
from touchd.daemon.config import Settings
from touchd.daemon.decide import NO_TOUCH
from touchd.drivers.extras import EXTRAS, how_to_install
from touchd.model.classifier import Classifier

# A bridge's section name and content, its pads, and the gestures that it announces.
Key = tuple[str, Section, tuple[str, ...], tuple[str, ...]]


def make_bridges(
    settings: Settings, models: Mapping[str, Classifier], before: Mapping[Key, Bridge]
) -> dict[Key, Bridge]:
    """Return the configured bridges; unchanged ones are kept, new ones are not yet started.

    models: for each pad. Raises BridgeError when a bridge cannot be used as configured.
    """
    wanted: list[Key] = []
    for name, section in settings.bridges.items():
        if isinstance(section, LslSettings | Ros2Settings):
            wanted.append((name, section, tuple(settings.pads), ()))
        elif section is not None:
            wanted += [
                (name, section, (pad,), _announced(section, own.scene.gestures or _touches(models[pad])))
                for pad, own in settings.pads.items()
            ]
    return {key: before.get(key) or _make(*key) for key in wanted}


def _make(name: str, section: Section, pads: tuple[str, ...], gestures: tuple[str, ...]) -> Bridge:
    for library in EXTRAS[name]:
        if importlib.util.find_spec(library) is None:
            raise BridgeError(f"{name}: {library} is not installed: {how_to_install(name)}")
    if isinstance(section, LslSettings | Ros2Settings):
        from touchd.daemon.bridges.apart import ApartBridge

        return ApartBridge(name, section, pads)
    module = importlib.import_module(f"touchd.daemon.bridges.{name}")
    bridge: Bridge = getattr(module, f"{name.capitalize()}Bridge")(section, *pads, gestures)
    return bridge


def _announced(section: Section, gestures: tuple[str, ...]) -> tuple[str, ...]:
    """Return the gestures if they are announced; other bridges outlast a change of them."""
    return gestures if isinstance(section, MqttSettings) and section.discovery is not None else ()


def _touches(model: Classifier) -> tuple[str, ...]:
    return tuple(label for label in model.labels if label != NO_TOUCH)
