"""Reads a YAML file into typed settings; a mistake in it is reported in one line."""

import difflib
import logging
import os
import re
import reprlib
import typing
from collections.abc import Hashable
from pathlib import Path
from typing import Annotated, Any, Literal, TypeVar

import msgspec
import yaml

from daemon.bridges.settings import LslSettings, MqttSettings, Ros2Settings, RosbridgeSettings, Section
from daemon.decide import DecisionSettings
from daemon.pipeline import PipelineSettings
from daemon.setup.words import Language, Vocabulary, vocabulary
from daemon.touch import TouchSettings
from drivers.errors import TouchdError
from drivers.frame import DEFAULT_PAD
from drivers.pad.format import PRESETS, PadFormat, Side
from drivers.pad.grid import RingSettings
from drivers.robot.actions import ActionRule, Words
from drivers.robot.settings import RobotSettings

T = TypeVar("T", bound=msgspec.Struct)
log = logging.getLogger(__name__)
RENAMED_TOUCH_KEYS = {"onset_level": "onset_threshold", "release_level": "release_threshold"}
Keys = tuple[str, ...]
Steps = tuple[str | int, ...]

PLAIN_WORDS = {
    "int": "a whole number",
    "float": "a number",
    "str": "text",
    "bool": "true or false",
    "object": "a section of settings",
    "array": "a list",
}

MAX_BYTES = 64 * 1024
DEFAULT_PORT = "/dev/touchd-pad"

MAX_PADS = 16
OVERRIDES = ("rows", "columns", "crop", "invert", "turn", "mirror")

# Not gt=0, here and elsewhere: msgspec makes that the smallest denormal float, which equals 0 once the model
# is loaded and denormals count as zero.
Length = Annotated[float, msgspec.Meta(ge=0.001, le=10_000)]


def state_folder() -> Path:
    """Return the folder for persistent state: systemd's for the service, else the user's."""
    if service := os.environ.get("STATE_DIRECTORY"):
        return Path(service)
    users = os.environ.get("XDG_STATE_HOME") or "~/.local/state"
    return Path(users).expanduser() / "touchd"


class ConfigError(TouchdError):
    """The settings cannot be used; the message is one line that names what is wrong and what to do."""


class SensorSettings(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """The pad and the line it is on.

    port: a device, a pty, tcp://host:port, udp://address:port to listen at, or any address that pyserial's
    `serial_for_url` takes. baud: bits per second.
    format: what the pad sends: the name of a preset, or a description; see docs/pads.md. protocol: the older
    name of format.
    rows, columns, crop, invert, turn, mirror: override those of the format.
    size_mm: height and width of the 8x8 taxels, for lengths in touches; None gives them in taxels alone.
    """

    port: Annotated[str, msgspec.Meta(min_length=1)] = DEFAULT_PORT
    baud: Annotated[int, msgspec.Meta(ge=1200, le=4_000_000)] = 512_000
    format: str | PadFormat | None = None
    protocol: Literal["fabric-grid", "csv"] = "fabric-grid"
    rows: Side | None = None
    columns: Side | None = None
    crop: Annotated[int, msgspec.Meta(ge=0, le=28)] | None = None
    invert: bool | None = None
    turn: Literal[0, 90, 180, 270] | None = None
    mirror: bool | None = None
    size_mm: tuple[Length, Length] | None = None

    def __post_init__(self) -> None:
        if isinstance(self.format, str) and self.format not in PRESETS:
            raise ValueError(f"format {self.format!r} is none of {', '.join(PRESETS)}, nor a description")
        if self.described.poll and self.port.startswith("udp://"):
            raise ValueError("a pad that has to be asked for frames cannot be reached at udp://; use tcp://")

    @property
    def described(self) -> PadFormat:
        """What the pad sends."""
        chosen = self.format or self.protocol
        described = PRESETS[chosen] if isinstance(chosen, str) else chosen
        own = {name: getattr(self, name) for name in OVERRIDES if getattr(self, name) is not None}
        return PadFormat(**(msgspec.structs.asdict(described) | own))


class SceneSettings(DecisionSettings, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """A scene for the pipeline, and what the robot does in it: see `drivers.robot.actions`."""

    actions: tuple[ActionRule, ...] = ()


class PadSettings(SensorSettings, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """One of several pads; scene and model default to those of the file."""

    scene: SceneSettings | None = None
    model: str | None = None


class JournalSettings(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """The file of events, one JSON object a line. It takes at most max_mb * (keep + 1) megabytes.

    path: null is events.jsonl in the service's state folder, or in the user's where there is no service.
    max_mb: size at which a new file is begun. keep: number of older files; path.1 is the newest.
    keep_touches: number of latest touches whose frames are kept in path.touches/, at most a minute of each;
    None keeps none.
    """

    path: str | None = None
    max_mb: Annotated[float, msgspec.Meta(ge=0.001, le=10_000)] = 10.0
    keep: Annotated[int, msgspec.Meta(ge=0, le=100)] = 5
    keep_touches: Annotated[int, msgspec.Meta(ge=1, le=10_000)] | None = None

    @property
    def file(self) -> Path:
        """The file that path stands for."""
        return state_folder() / "events.jsonl" if self.path is None else Path(self.path).expanduser()


class LiveSettings(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Where the live page is served.

    host: 127.0.0.1 is this computer alone; 0.0.0.0 is everyone who can reach it. port: 0 is any that is free.
    """

    host: Annotated[str, msgspec.Meta(min_length=1)] = "127.0.0.1"
    port: Annotated[int, msgspec.Meta(ge=0, le=65535)] = 8054


class Settings(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Everything `touchd run` can be told. model: an ONNX file, null for the one that ships with touchd.

    sensor: the only pad. sensors: instead of it, several pads by their names. language: of gesture names on
    robot, page and terminal. words: a gesture's name and phrase, replacing the shipped ones.
    """

    sensor: SensorSettings = SensorSettings()
    sensors: dict[str, PadSettings] = {}
    model: str | None = None
    ring: RingSettings = RingSettings()
    touch: TouchSettings = TouchSettings()
    scene: SceneSettings = SceneSettings()
    robot: RobotSettings | None = None
    journal: JournalSettings | None = None
    live: LiveSettings | None = None
    mqtt: MqttSettings | None = None
    lsl: LslSettings | None = None
    ros2: Ros2Settings | None = None
    rosbridge: RosbridgeSettings | None = None
    language: Language = "en"
    words: dict[str, Words] = {}
    log_level: Literal["debug", "info", "warning", "error"] = "info"

    def __post_init__(self) -> None:
        if self.sensors and self.sensor != SensorSettings():
            raise ValueError("sensor and sensors are both set; keep one")
        if len(self.sensors) > MAX_PADS:
            raise ValueError(f"sensors: {len(self.sensors)} pads, {MAX_PADS} at most; run another touchd")
        for name in self.sensors:
            if not re.fullmatch(r"[A-Za-z]\w{0,31}", name):
                raise ValueError(f"sensors: {name!r} is no name of a pad; use one word such as left_arm")
            if not name.isascii() and (self.ros2 or self.rosbridge or (self.mqtt and self.mqtt.discovery)):
                raise ValueError(f"sensors: {name}: ROS and Home Assistant take only a to z, 0 to 9 and _")
        ports = [pad.port for pad in self.sensors.values()]
        if shared := [port for port in ports if ports.count(port) > 1]:
            raise ValueError(f"sensors: {shared[0]} is the port of more than one pad; give each its own")

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
    def model_path(self) -> Path | None:
        """The configured ONNX file, None for the shipped one."""
        return None if self.model is None else Path(self.model).expanduser()

    @property
    def bridges(self) -> dict[str, Section | None]:
        return {"mqtt": self.mqtt, "lsl": self.lsl, "ros2": self.ros2, "rosbridge": self.rosbridge}

    @property
    def vocabulary(self) -> Vocabulary:
        return vocabulary(self.language, self.words)

    @property
    def pipeline(self) -> PipelineSettings:
        return PipelineSettings(
            ring=self.ring, touch=self.touch, decision=self.scene, size_mm=self.sensor.size_mm
        )


def only_pad(settings: Settings, name: str | None, port: str | None = None) -> Settings:
    """Return the settings of one pad, at another port if given; only one of several pads needs its name.

    Raises ConfigError when there is no such pad, or the name is missing.
    """
    pads = settings.pads
    chosen = pads.get(name) if name else next(iter(pads.values())) if len(pads) == 1 else None
    if chosen is None:
        wrong = f"{name} is no pad" if name else "several pads are configured"
        raise ConfigError(f"{wrong}; give --pad one of {', '.join(pads)}")
    if port is None:
        return chosen
    return msgspec.structs.replace(chosen, sensor=msgspec.structs.replace(chosen.sensor, port=port))


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
    try:
        return convert(text, Settings)
    except StrictYamlError as error:
        raise ConfigError(f"{path}: {error}") from error


class StrictYamlError(Exception):
    """The text is not YAML, or not what the struct asks for; the message is one line."""


SYNTAX_HINTS = {
    "mapping values are not allowed": "a colon too many, or a wrong indentation",
    "expected <block end>": "the indentation does not fit the lines above",
    "could not find expected ':'": "a colon is missing after the setting's name",
    "cannot start any token": "tabs and characters such as @ and % cannot stand here; indent with blanks",
    "expected ',' or": "a comma or a closing bracket is missing",
    "unexpected end of stream": "a quote is not closed",
}


class _StrictLoader(yaml.SafeLoader):
    """Refuses duplicate keys, of which YAML silently takes the last, and aliases.

    A few hundred bytes of aliases can expand to gigabytes.
    """

    def __init__(self, text: bytes | str) -> None:
        super().__init__(text)
        self.empty: list[str] = []

    def compose_node(self, parent: yaml.Node | None, index: int) -> yaml.Node | None:
        if self.check_event(yaml.AliasEvent):
            raise yaml.constructor.ConstructorError(
                problem="aliases (*name) are not taken; write the value out",
                problem_mark=self.peek_event().start_mark,  # type: ignore[no-untyped-call]
            )
        return super().compose_node(parent, index)

    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict[Hashable, Any]:
        seen: set[str] = set()
        for key, value in node.value:
            if isinstance(key, yaml.ScalarNode):
                if isinstance(value, yaml.ScalarNode) and not value.value and value.style is None:
                    self.empty.append(f"line {key.start_mark.line + 1}: {key.value}")
                if key.value in seen:
                    raise yaml.constructor.ConstructorError(
                        problem=f"{key.value} is set twice", problem_mark=key.start_mark
                    )
                seen.add(key.value)
        return super().construct_mapping(node, deep)


def convert(text: bytes | str, struct: type[T]) -> T:
    """Return the struct that YAML text describes; an empty text is all defaults. Raises StrictYamlError."""
    try:
        loader = _StrictLoader(text)
        raw = loader.get_single_data()
    except yaml.MarkedYAMLError as error:
        raise StrictYamlError(_plain_syntax(error)) from error
    except (yaml.YAMLError, RecursionError, ValueError) as error:
        raise StrictYamlError(f"not YAML: {' '.join(str(error).split())}") from error
    _rename(raw)
    try:
        converted = msgspec.convert({} if raw is None else raw, struct)
    except msgspec.ValidationError as error:
        raise StrictYamlError(_plainly(str(error), raw, struct)) from error
    for empty in loader.empty:
        log.warning("configuration, %s is empty, so not used; {} takes its defaults", empty)
    return converted


def _rename(raw: object) -> None:
    """Accept key names of the previous release, with a warning each."""
    touch = raw.get("touch") if isinstance(raw, dict) else None
    if not isinstance(touch, dict):
        return
    for old, new in RENAMED_TOUCH_KEYS.items():
        if old in touch and new not in touch:
            log.warning("touch.%s is now called touch.%s; rename it, the next release refuses it", old, new)
            touch[new] = touch.pop(old)


def _plain_syntax(error: yaml.MarkedYAMLError) -> str:
    """Return what is wrong with text that is not YAML, where, and what to look for."""
    mark = error.problem_mark or error.context_mark
    where = f"line {mark.line + 1}" if mark else "the text"
    problem = error.problem or "not YAML"
    if isinstance(error, yaml.constructor.ConstructorError):
        return f"{where}: {problem}"
    where += f", column {mark.column + 1}: " if mark else ": "
    hint = next(
        (hint for part, hint in SYNTAX_HINTS.items() if part in problem), "check it and the line above"
    )
    return f"{where}{hint} ({problem})"


def _path_to(where: str, raw: Any, struct: type[msgspec.Struct]) -> Steps:
    """Return the names and places that lead to a wrong value; msgspec calls a name in a mapping "..."."""
    path: Steps = ()
    for name, place in re.findall(r"\.(\w+)|\[(\d+|\.\.\.)\]", where):
        if place == "...":
            section = _section(struct, _names(path[:-1]))
            hint = typing.get_type_hints(section, include_extras=True)[_names(path)[-1]]
            of = next(typing.get_args(part)[1] for part in _parts(hint) if typing.get_origin(part) is dict)
            path += (next(key for key, value in _value(raw, path).items() if not _is(value, of)),)
        else:
            path += (name or int(place),)
    return path


def _names(path: Steps) -> Keys:
    return tuple(step for step in path if isinstance(step, str))


def _is(value: Any, kind: Any) -> bool:
    try:
        msgspec.convert(value, kind)
    except msgspec.ValidationError:
        return False
    return True


def _plainly(message: str, raw: Any, struct: type[msgspec.Struct]) -> str:
    """Turn msgspec's message into one that names the setting, the allowed values and the given one."""
    problem, _, where = message.partition(" - at `")
    path = _path_to(where, raw, struct)
    keys, value = _names(path), _value(raw, path)
    name = ".".join(keys)
    if where.startswith("key`"):
        name, value = f"a name in {name}", list(value)
    unknown = re.fullmatch(r"Object contains unknown field `(.*)`", problem)
    if unknown:
        return _unknown_key(keys, unknown[1], struct)
    missing = re.fullmatch(r"Object missing required field `(.*)`", problem)
    if missing:
        return f"{'.'.join((*keys, missing[1]))} is missing and has no default"
    if value is None and name:
        return f"{name} is empty; give it a value, or leave it out"
    if problem.startswith("Invalid enum value"):
        return f"{name} must be {_choices(struct, keys)}, not {_shortly(value)}"
    expected = re.fullmatch(r"Expected `(.*?)`(.*?)(, got .*)?", problem)
    if expected:
        kinds = " or ".join(PLAIN_WORDS.get(kind, kind) for kind in expected[1].split(" | "))
        how = expected[2]
        if how.startswith(" matching regex"):
            default = getattr(_section(struct, keys[:-1])(), keys[-1])
            how = f" such as {default}" if default else " in another form"
        hint = "; put it in quotes" if kinds == "text" and isinstance(value, int | float) else ""
        return f"{name or 'the file'} must be {kinds}{how}, not {_shortly(value)}{hint}"
    return f"{name}: {problem}" if name else problem


def _unknown_key(keys: Keys, wrong: str, struct: type[msgspec.Struct]) -> str:
    if wrong == "token":
        # A hint at a similar setting would have the token written there, and shown.
        return "robot.token is not a setting: put the token into a file of its own and name it in token_file"
    homes = [name for name in struct.__struct_fields__ if (name,) != keys and wrong in _known(struct, name)]
    if homes:
        return f"{'.'.join((*keys, wrong))} is not a setting; it belongs under {' or '.join(homes)}:"
    known = _section(struct, keys).__struct_fields__
    near = difflib.get_close_matches(wrong, known, n=1, cutoff=0.5)
    advice = f"did you mean {near[0]}?" if near else f"known here: {', '.join(known)}"
    return f"{'.'.join((*keys, wrong))} is not a setting; {advice}"


def _known(struct: type[msgspec.Struct], name: str) -> tuple[str, ...]:
    """Return the settings of a section, none of another value or a mapping."""
    parts = _parts(typing.get_type_hints(struct)[name])
    sections = [part for part in parts if isinstance(part, type) and issubclass(part, msgspec.Struct)]
    return sections[0].__struct_fields__ if sections and typing.get_origin(parts[0]) is not dict else ()


def _choices(struct: type[msgspec.Struct], keys: Keys) -> str:
    """Return the words that a Literal setting may be, as a list for people."""
    hint = typing.get_type_hints(_section(struct, keys[:-1]))[keys[-1]]
    literals = [part for part in _parts(hint) if typing.get_origin(part) is Literal]
    return " or ".join(str(choice) for literal in literals for choice in typing.get_args(literal))


def _section(struct: type[msgspec.Struct], keys: Keys) -> type[msgspec.Struct]:
    for key in keys:
        if key not in struct.__struct_fields__:
            # A name in a mapping, whose values the struct describes.
            continue
        parts = _parts(typing.get_type_hints(struct)[key])
        struct = next(part for part in parts if isinstance(part, type) and issubclass(part, msgspec.Struct))
    return struct


def _parts(hint: Any) -> list[Any]:
    """Return a type and its components: `tuple[A, ...] | None` holds A."""
    return [hint, *(part for argument in typing.get_args(hint) for part in _parts(argument))]


def _value(raw: Any, path: Steps) -> Any:
    for step in path:
        raw = raw.get(step) if isinstance(raw, dict) else raw[step]
    return raw


def _shortly(value: Any) -> str:
    # Two levels are enough to recognise a value; deeper ones could be huge.
    short = reprlib.Repr()
    short.maxlevel = 2
    return short.repr(value)
