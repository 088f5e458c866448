"""Reads a YAML file into typed settings; a mistake in it is reported in one line.

touchd.example.yaml explains every setting, docs/pads.md the format of a pad.
"""

import errno
import os
import re
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from difflib import get_close_matches
from pathlib import Path
from typing import Annotated, Literal, TypeAlias

import msgspec

from touchd.daemon.app.strict_yaml import ConfigError as ConfigError
from touchd.daemon.app.strict_yaml import convert
from touchd.daemon.bridges.settings import (
    LslSettings,
    MqttSettings,
    RobotName,
    Ros2Settings,
    RosbridgeSettings,
    Section,
)
from touchd.daemon.path.decide import DecisionSettings
from touchd.daemon.path.pipeline import PipelineSettings
from touchd.daemon.path.tracker import TouchSettings
from touchd.daemon.robot.actions import ActionRule, Name
from touchd.drivers.errors import TouchdError, expand_home
from touchd.drivers.frame import DEFAULT_PAD, ROWS
from touchd.drivers.pad.format import PRESETS, PadFormat, SentFormat
from touchd.drivers.robot.session import RobotSettings

MAX_BYTES = 64 * 1024
MAX_PADS = 16
PAD_NAME = re.compile(r"[A-Za-z][A-Za-z0-9_]{0,31}")
DEFAULT_PORT = "/dev/touchd-pad"

# Errors of a machine that has no descriptors or memory left.
NO_ROOM = (errno.EMFILE, errno.ENFILE, errno.ENOMEM)

Language: TypeAlias = Literal["en", "de"]
# Not gt=0, here and elsewhere: msgspec turns that into the smallest denormal float, which counts as 0 once
# the model is loaded.
Length = Annotated[float, msgspec.Meta(ge=0.001, le=10_000)]


@contextmanager
def config_errors() -> Iterator[None]:
    """Turn any error that a configuration causes into ConfigError, except a lack of descriptors or memory."""
    try:
        yield
    except TouchdError:
        raise
    except (ValueError, OSError) as error:
        if getattr(error, "errno", None) in NO_ROOM:
            raise
        raise ConfigError(f"the configuration cannot be used: {error}; check its values") from error


def _check_pads(ports: Mapping[str, str]) -> None:
    """Raise ValueError if names or ports do not distinguish the pads, also in ROS and Home Assistant."""
    if len(ports) > MAX_PADS:
        raise ValueError(f"sensors: {len(ports)} pads, {MAX_PADS} at most; run another touchd")
    named: dict[str, str] = {}
    for name, port in ports.items():
        if not PAD_NAME.fullmatch(name) or "__" in name:
            raise ValueError(f"sensors: invalid pad name {name!r}; use a to z, 0 to 9 and _, as in left_arm")
        device = port.lower() if "://" in port else os.path.realpath(port)
        other = named.setdefault(device, name)
        if other != name:
            raise ValueError(f"sensors: {other} and {name} have the same port, {port}; give each its own")


class SensorSettings(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """The pad, its port, and how it is mounted: turned clockwise, then left and right swapped."""

    port: Annotated[str, msgspec.Meta(min_length=1)] = DEFAULT_PORT
    baud: Annotated[int, msgspec.Meta(ge=1200, le=4_000_000)] = 512_000
    format: str | SentFormat = "fabric-grid"
    turn: Literal[0, 90, 180, 270] = 0
    mirror: bool = False
    size_mm: tuple[Length, Length] | None = None

    def __post_init__(self) -> None:
        if isinstance(self.format, str) and self.format not in PRESETS:
            near = get_close_matches(self.format, PRESETS, n=1)
            advice = f"did you mean {near[0]}?" if near else "it may also be a description"
            raise ValueError(f"format {self.format!r} is none of {', '.join(PRESETS)}; {advice}")
        has_mark = self.described.header or self.described.framing != "binary"
        if not has_mark and not self.port.startswith("udp://"):
            raise ValueError("a binary format needs a header; lines of numbers need framing: text")

    @property
    def described(self) -> PadFormat:
        """The format of the pad as it is mounted."""
        sent = PRESETS[self.format] if isinstance(self.format, str) else self.format
        return PadFormat(**(msgspec.structs.asdict(sent) | {"turn": self.turn, "mirror": self.mirror}))


class SceneSettings(DecisionSettings, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """A scene for the pipeline, and what the robot does in it: see `touchd.daemon.robot.actions`."""

    actions: tuple[ActionRule, ...] = ()


class PadSettings(SensorSettings, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """One of several pads; scene and model default to those of the file."""

    scene: SceneSettings | None = None
    model: str | None = None


class JournalSettings(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """The file of events, one JSON object a line. path.1 to path.5 are older files, path.1 the newest."""

    path: str | None = None
    keep_touches: Annotated[int, msgspec.Meta(ge=1, le=10_000)] | None = None

    @property
    def file(self) -> Path:
        """The file: path, or by default one in the service's or the user's state folder."""
        if self.path is not None:
            return expand_home(self.path)
        if service := os.environ.get("STATE_DIRECTORY"):
            return Path(service) / "events.jsonl"
        users = os.environ.get("XDG_STATE_HOME") or "~/.local/state"
        return expand_home(users) / "touchd" / "events.jsonl"


class LiveSettings(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Where the live page is served. port: 0 is any that is free."""

    host: Annotated[str, msgspec.Meta(min_length=1)] = "127.0.0.1"
    port: Annotated[int, msgspec.Meta(ge=0, le=65535)] = 8054
    label: bool = False


class Words(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """A gesture's name ("pat"), and its form in a sentence ("a pat")."""

    name: Name
    phrase: Name


class Settings(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """All settings of `touchd run`. sensor: the only pad. sensors: instead of it, several by their names.

    name: distinguishes this robot's topics and streams from those of others.
    """

    sensor: SensorSettings = SensorSettings()
    sensors: dict[str, PadSettings] = {}
    model: str | None = None
    touch: TouchSettings = TouchSettings()
    scene: SceneSettings = SceneSettings()
    robot: RobotSettings | None = None
    journal: JournalSettings | None = None
    live: LiveSettings | None = None
    mqtt: MqttSettings | None = None
    lsl: LslSettings | None = None
    ros2: Ros2Settings | None = None
    rosbridge: RosbridgeSettings | None = None
    name: RobotName = "touchd"
    language: Language = "en"
    words: dict[str, Words] = {}

    def __post_init__(self) -> None:
        if self.sensors and self.sensor != SensorSettings():
            raise ValueError("sensor and sensors are both set; keep one")
        if self.sensors:
            _check_pads({name: pad.port for name, pad in self.sensors.items()})

    @property
    def pads(self) -> dict[str, "Settings"]:
        """Each pad's name with settings in which it is the only one, as `sensor`."""
        if not self.sensors:
            return {DEFAULT_PAD: self}
        return {
            name: msgspec.structs.replace(
                self,
                sensors={},
                sensor=SensorSettings(**{key: getattr(pad, key) for key in SensorSettings.__struct_fields__}),
                scene=pad.scene or self.scene,
                model=pad.model or self.model,
            )
            for name, pad in self.sensors.items()
        }

    @property
    def bridges(self) -> dict[str, Section | None]:
        return {"mqtt": self.mqtt, "lsl": self.lsl, "ros2": self.ros2, "rosbridge": self.rosbridge}

    @property
    def pipeline(self) -> PipelineSettings:
        size_mm, is_finer = self.sensor.size_mm, max(self.sensor.described.used) > ROWS
        return PipelineSettings(touch=self.touch, decision=self.scene, size_mm=size_mm, is_finer=is_finer)


def load(path: Path) -> Settings:
    """Read a configuration file; raises ConfigError with one line that says what to do."""
    try:
        with path.open("rb") as file:
            text = file.read(MAX_BYTES + 1)
    except OSError as error:
        denied = isinstance(error, PermissionError)
        advice = "put sudo before the command" if denied else "check the path after -c"
        raise ConfigError(f"{path}: cannot be read ({error.strerror}); {advice}") from error
    if len(text) > MAX_BYTES:
        raise ConfigError(f"{path}: larger than {MAX_BYTES // 1024} KiB, so not a touchd configuration")
    return convert(path, text, Settings)
