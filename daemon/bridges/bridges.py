"""Makes the bridges that are configured: for each section one a pad, or one process for all pads."""

import importlib.util
from collections.abc import Mapping, Sequence
from pathlib import Path

from touchd.daemon.bridges.bridge import Bridge, BridgeError, bridge_class
from touchd.daemon.bridges.settings import LslSettings, MqttSettings, Ros2Settings, Section
from touchd.drivers.installed import EXTRAS, how_to_install


def make_bridges(
    sections: Mapping[str, Section | None], gestures: Mapping[str, Sequence[str]], memory: Path
) -> list[Bridge]:
    """Return the configured bridges, not yet started.

    gestures: that each pad can tell. memory: the file of `Retained`. Raises BridgeError when a
    bridge cannot be used as configured.
    """
    bridges: list[Bridge] = []
    for name, section in sections.items():
        if isinstance(section, LslSettings | Ros2Settings):
            bridges.append(_make(name, section, tuple(gestures), ()))
        elif isinstance(section, MqttSettings):
            bridges += _mqtt_bridges(section, gestures, memory)
        elif section is not None:
            bridges += [_make(name, section, (pad,), tuple(own)) for pad, own in gestures.items()]
    return bridges


def _mqtt_bridges(section: MqttSettings, gestures: Mapping[str, Sequence[str]], memory: Path) -> list[Bridge]:
    _check_libraries("mqtt")
    from touchd.daemon.bridges.mqtt import MqttBridge, retained_topics
    from touchd.daemon.bridges.retained import Retained

    topics = [topic for pad in gestures for topic in retained_topics(section, pad)]
    retained = Retained(memory, f"{section.host}:{section.port}", topics)
    # The first one clears for all.
    return [
        MqttBridge(section, pad, tuple(own), None if number else retained)
        for number, (pad, own) in enumerate(gestures.items())
    ]


def _make(name: str, section: Section, pads: tuple[str, ...], gestures: tuple[str, ...]) -> Bridge:
    _check_libraries(name)
    if isinstance(section, LslSettings | Ros2Settings):
        from touchd.daemon.bridges.apart import ApartBridge

        return ApartBridge(name, section, pads)
    bridge: Bridge = bridge_class(name)(section, *pads, gestures)
    return bridge


def _check_libraries(name: str) -> None:
    for library in EXTRAS[name]:
        if importlib.util.find_spec(library) is None:
            raise BridgeError(f"{name}: {library} is not installed: {how_to_install(name)}")
