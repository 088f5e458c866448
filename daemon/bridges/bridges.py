"""Makes the bridges that are configured: for each section one a pad, or one process for all pads."""

import importlib.util
from collections.abc import Mapping

from touchd.daemon.app.config import Settings
from touchd.daemon.bridges.bridge import Bridge, BridgeError
from touchd.daemon.bridges.settings import LslSettings, MqttSettings, Ros2Settings
from touchd.daemon.path.decide import told_in
from touchd.drivers.installed import EXTRAS, how_to_install
from touchd.model.classifier import Classifier


def make_bridges(settings: Settings, models: Mapping[str, Classifier]) -> tuple[Bridge, ...]:
    """Return the configured bridges, not yet started.

    models: of each pad. Raises BridgeError when a bridge cannot be used as configured.
    """
    bridges: list[Bridge] = []
    for name, section in settings.bridges.items():
        if section is None:
            continue
        for library in EXTRAS[name]:
            if importlib.util.find_spec(library) is None:
                raise BridgeError(f"{name}: {library} is not installed: {how_to_install(name)}")
        if isinstance(section, LslSettings | Ros2Settings):
            from touchd.daemon.bridges.apart import ApartBridge

            bridges.append(ApartBridge(section, settings.name, tuple(settings.pads)))
        elif isinstance(section, MqttSettings):
            from touchd.daemon.bridges.mqtt import MqttBridge

            for pad, own in settings.pads.items():
                labels = told_in(own.scene.gestures, models[pad].labels)
                bridges.append(MqttBridge(section, settings.name, pad, labels))
        else:
            from touchd.daemon.bridges.rosbridge import RosbridgeBridge

            bridges += (RosbridgeBridge(section, settings.name, pad) for pad in settings.pads)
    return tuple(bridges)
