"""Makes the bridges that are configured: for each section one a pad, or one process for all pads."""

import importlib.util
from collections.abc import Mapping, Sequence

from touchd.daemon.bridges.bridge import Bridge, BridgeError, bridge_class
from touchd.daemon.bridges.settings import LslSettings, Ros2Settings, Section
from touchd.drivers.installed import EXTRAS, how_to_install


def make_bridges(
    sections: Mapping[str, Section | None], gestures: Mapping[str, Sequence[str]]
) -> list[Bridge]:
    """Return the configured bridges, not yet started.

    gestures: that each pad can tell. Raises BridgeError when a bridge cannot be used as configured.
    """
    bridges: list[Bridge] = []
    for name, section in sections.items():
        if isinstance(section, LslSettings | Ros2Settings):
            bridges.append(_make(name, section, tuple(gestures), ()))
        elif section is not None:
            bridges += [_make(name, section, (pad,), tuple(own)) for pad, own in gestures.items()]
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
