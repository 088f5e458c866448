"""From the settings to the bridges: one for each pad and each section that is set."""

import importlib
from collections.abc import Mapping

from touchd.daemon.bridges.bridge import Bridge, BridgeError
from touchd.daemon.bridges.settings import MqttSettings, Section
from touchd.daemon.config import Settings
from touchd.daemon.decide import NO_TOUCH
from touchd.drivers.extras import how_to_install
from touchd.model.classifier import Classifier

# A bridge's section name and content, its pad, and the gestures that it announces.
Key = tuple[str, Section, str, tuple[str, ...]]


def make_bridges(
    settings: Settings, models: Mapping[str, Classifier], before: Mapping[Key, Bridge]
) -> dict[Key, Bridge]:
    """Return the configured bridges; unchanged ones are kept, new ones are not yet started.

    models: for each pad. Raises BridgeError when a bridge cannot be used as configured.
    """
    wanted = [
        (name, section, pad, _announced(section, own.scene.gestures or _touches(models[pad])))
        for name, section in settings.bridges.items()
        if section is not None
        for pad, own in settings.pads.items()
    ]
    return {key: before.get(key) or _make(*key) for key in wanted}


def _make(name: str, section: Section, pad: str, gestures: tuple[str, ...]) -> Bridge:
    try:
        module = importlib.import_module(f"touchd.daemon.bridges.{name}")
    except ImportError as error:
        raise BridgeError(f"{name}: {error.name} is not installed: {how_to_install(name)}") from error
    except RuntimeError as error:
        # pylsl without its library, as on a processor that it is not built for.
        raise BridgeError(f"{name}: cannot be used on this machine ({error})") from error
    bridge: Bridge = getattr(module, f"{name.capitalize()}Bridge")(section, pad, gestures)
    return bridge


def _announced(section: Section, gestures: tuple[str, ...]) -> tuple[str, ...]:
    """Return the gestures if they are announced; other bridges outlast a change of them."""
    return gestures if isinstance(section, MqttSettings) and section.discovery is not None else ()


def _touches(model: Classifier) -> tuple[str, ...]:
    return tuple(label for label in model.labels if label != NO_TOUCH)
