"""Makes the bridges that are configured: for each section one a pad, or one process for all pads."""

import importlib.util
import logging
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from touchd.daemon.app.config import Settings
from touchd.daemon.bridges.bridge import Bridge, BridgeError, bridge_class
from touchd.daemon.bridges.settings import LslSettings, MqttSettings, Ros2Settings, Section
from touchd.daemon.path.decide import told_in
from touchd.drivers.installed import EXTRAS, how_to_install
from touchd.model.classifier import Classifier

if TYPE_CHECKING:
    from touchd.daemon.bridges.retained import Retained

log = logging.getLogger(__name__)


def make_bridges(
    settings: Settings, models: Mapping[str, Classifier], state: Path, config: Path | None
) -> tuple[Bridge, ...]:
    """Return the configured bridges, not yet started, and those that clear what former ones left on a broker.

    models: of each pad. state: the state folder. config: the file of the settings; without one nothing is
    remembered. Raises BridgeError when a bridge cannot be used as configured.
    """
    gestures = {name: told_in(pad.scene.gestures, models[name].labels) for name, pad in settings.pads.items()}
    retained = _retained(settings.mqtt, gestures, state, config) if config is not None else None
    bridges: list[Bridge] = []
    for name, section in settings.bridges.items():
        if isinstance(section, LslSettings | Ros2Settings):
            bridges.append(_make(name, section, tuple(gestures), ()))
        elif isinstance(section, MqttSettings):
            bridges += _mqtt_bridges(section, gestures, retained.reached if retained else lambda: None)
        elif section is not None:
            bridges += [_make(name, section, (pad,), tuple(own)) for pad, own in gestures.items()]
    if retained is not None:
        bridges += _clearings(retained)
    return tuple(bridges)


def _mqtt_bridges(
    section: MqttSettings, gestures: Mapping[str, Sequence[str]], reached: Callable[[], None]
) -> list[Bridge]:
    _check_libraries("mqtt")
    from touchd.daemon.bridges.mqtt import MqttBridge

    return [MqttBridge(section, pad, tuple(own), reached) for pad, own in gestures.items()]


def _retained(section: MqttSettings | None, pads: Iterable[str], state: Path, config: Path) -> "Retained":
    """Return the topics that the section retains, and those that former ones left."""
    from touchd.daemon.bridges.retained import OnBroker, Retained, topics_of

    present = None
    if section is not None:
        topics = tuple(topic for pad in pads for topic in topics_of(section, pad))
        present = OnBroker(section, topics)
    return Retained(state, config, present)


def _clearings(retained: "Retained") -> list[Bridge]:
    """Return what clears the topics that former configurations left, by broker."""
    clearings: list[Bridge] = []
    for former in retained.former:
        try:
            _check_libraries("mqtt")
            from touchd.daemon.bridges.clearing import Clearing

            clearings.append(Clearing(former, retained))
        except BridgeError as error:
            # A file that a former configuration named may be gone with it.
            log.warning("%s stay at %s: %s", ", ".join(former.topics), former.broker.host, error)
    return clearings


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
