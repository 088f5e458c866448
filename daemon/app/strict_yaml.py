"""Reads YAML text strictly into a struct; a mistake is reported in one line: where, what, what it may be."""

import difflib
import re
import typing
from collections.abc import Hashable, Iterator
from pathlib import Path
from typing import Any, Literal, TypeVar

import msgspec
import yaml

from touchd.drivers.errors import TouchdError

T = TypeVar("T", bound=msgspec.Struct)

MERGE_TAG = "tag:yaml.org,2002:merge"
# Messages of msgspec: a problem and its path; problems with a value.
PLACED = re.compile(r"(.*) - at `(?:key` in `)?\$?\.?(.*)`", re.DOTALL)
UNKNOWN = re.compile(r"Object contains unknown field `(.*)`")
WRONG_KIND = re.compile(r"Expected `(.*)`, got `(.*)`")
OUT_OF_RANGE = re.compile(r"Expected `(?:int|float)` ([<>]=?) (.*)")
# Other messages of msgspec, and touchd's own. {form}: an example of the setting. {choices}: allowed values.
PROBLEMS = {
    r"Expected `str` matching regex .*": "another form expected, as in {form}",
    r"Invalid enum value (.*)": "{0} is not one of {choices}",
    r"Object missing required field `(.*)`": "{0} is missing",
    r"Expected `array` of length (\d+), got (\d+)": "{0} values expected, not {1}",
    r"Expected `(?:str|array)` of length >= 1": "must not be empty",
    r"Expected `str`": "a name before a colon is not text; put it in quotes if it is a number or on, off, "
    "yes, no",
}
LIMITS = {">=": "at least", "<=": "at most", ">": "more than", "<": "less than"}
# The unit of a setting, by the end of its name.
UNITS = {"_s": "seconds", "_hz": "per second", "_mm": "millimetres", "_frames": "frames"}
# msgspec's names of types, in words.
KINDS = {
    "object": "settings (name: value, or {})",
    "array": "a list (- item)",
    "str": "text (in quotes)",
    "int": "a whole number",
    "float": "a number",
    "bool": "true or false",
}
# Examples of settings whose text has a certain form, and of sections that may be mistaken for a single value.
EXAMPLES = {
    "discovery": "discovery: homeassistant",
    "host": "host: broker.local",
    "name": "name: lab/nao1",
    "url": "url: ws://robot:9090",
    "words": "words: {stroke: {name: caress, phrase: a caress}}",
    "journal": "journal: {path: events.jsonl}",
    "live": "live: {port: 8054}",
    "mqtt": "mqtt: {host: broker.local}",
    "robot": "robot: {url: 'tcp://nao.local:9559'}",
    "rosbridge": "rosbridge: {url: 'ws://robot:9090'}",
}

# Parts of PyYAML's messages, and touchd's own for them.
INDENTED = "indent this line as far as the other settings of its section"
YAML_PROBLEMS = {
    "'\\t'": "indent with spaces, not with tabs",
    "found '<block mapping start>'": INDENTED,
    "found '<block sequence start>'": INDENTED,
    "mapping values are not allowed here": "a colon where none can stand: is this line indented too far, "
    "does a line above lack ': ' after its name, or a text with a colon its quotes?",
    "<document start>": "settings (name: value) expected",
    "found another document": "one document expected; remove the line ---",
    "determine a constructor": "tags (!name) are not allowed; write the value alone",
    "found unexpected end of stream": "a quote is opened above and not closed",
}
NO_VALUE = "has no value; write null for none, {} for the defaults; a list is [a, b], a fraction 0.5"
# They look like spaces, but YAML reads them as part of a name or value.
INVISIBLE = re.compile("[\u00a0\u2002-\u200b\u202f\u2060\ufeff]")


class ConfigError(TouchdError):
    """The settings cannot be used; the message is one line that names what is wrong and what to do."""


class StrictLoader(yaml.SafeLoader):
    """Refuses aliases and merge keys, duplicate keys, and keys without a value.

    A few hundred bytes of aliases can expand to gigabytes. Of duplicate keys, YAML takes the last. A
    section whose lines are all commented out would be null, which is not what its heading suggests.
    """

    def compose_node(self, parent: yaml.Node | None, index: int) -> yaml.Node | None:
        if self.check_event(yaml.AliasEvent):
            raise _problem("aliases (*name) are not allowed; write the value out", self.peek_event())  # type: ignore[no-untyped-call]
        return super().compose_node(parent, index)

    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict[Hashable, Any]:
        seen: set[str] = set()
        for key, value in node.value:
            if key.tag == MERGE_TAG:
                raise _problem("merge keys (<<) are not allowed; write the settings out", key)
            if not isinstance(key, yaml.ScalarNode):
                continue
            if key.value in seen:
                raise _problem(f"{key.value} is set twice", key)
            if isinstance(value, yaml.ScalarNode) and not value.value and value.style is None:
                raise _problem(f"{key.value} {NO_VALUE}", key)
            seen.add(key.value)
        return super().construct_mapping(node, deep)


def _problem(what: str, place: Any) -> yaml.MarkedYAMLError:
    return yaml.constructor.ConstructorError(problem=what, problem_mark=place.start_mark)


def convert(file: Path, text: bytes, struct: type[T]) -> T:
    """Return the struct that a file's text describes; an empty one is all defaults. Raises ConfigError."""
    try:
        raw = StrictLoader(text).get_single_data()
    except yaml.MarkedYAMLError as error:
        raise ConfigError(f"{file}: {explain_yaml(error, text)}") from error
    except yaml.reader.ReaderError as error:
        line = len(text[: error.position + 1].splitlines())
        raise ConfigError(f"{file}: line {line}: {error.reason}; save the file as UTF-8 text") from error
    except (yaml.YAMLError, RecursionError, ValueError) as error:
        raise ConfigError(f"{file}: not YAML: {error}") from error
    try:
        return msgspec.convert({} if raw is None else raw, struct)
    except msgspec.ValidationError as error:
        raise ConfigError(f"{file}: {explain(str(error), struct, raw)}{_invisible(text)}") from error


def explain_yaml(error: yaml.MarkedYAMLError, text: bytes) -> str:
    """Return where a text is not YAML and why, for somebody who does not know YAML."""
    mark = error.problem_mark or error.context_mark
    where = f"line {mark.line + 1}, column {mark.column + 1}: " if mark else ""
    problem = str(error.problem)
    words = next((words for part, words in YAML_PROBLEMS.items() if part in problem), problem)
    return where + words + _invisible(text)


def _invisible(text: bytes) -> str:
    """Point out a character that looks like a space but is not one, as pages and mails contain."""
    lines = text.decode(errors="replace").removeprefix("\ufeff").splitlines()
    for number, line in enumerate(lines, 1):
        if found := INVISIBLE.search(line.partition("#")[0]):
            what = f"U+{ord(found[0]):04X}, perhaps copied from a page"
            return f"; line {number} has an invisible character ({what}): type its spaces again"
    return ""


def explain(error: str, struct: type[msgspec.Struct], raw: object) -> str:
    """Turn the text of a msgspec.ValidationError about a struct into one line. raw: what was converted."""
    placed = PLACED.fullmatch(error)
    problem, path = placed.groups() if placed else (error, "")
    setting = _without_items(path)
    name = setting.rpartition(".")[2]
    if match := UNKNOWN.fullmatch(problem):
        return _unknown(match[1], path, struct)
    kinds = (kind for known, kind in settings_in(struct) if known == setting)
    choices = ", ".join(str(each) for kind in kinds for each in _choices(kind))
    if match := WRONG_KIND.fullmatch(problem):
        wanted = f"one of {choices}" if choices and match[1] in ("str", "int") else match[1]
        problem = _wrong_kind(wanted, match[2], EXAMPLES.get(name))
    elif match := OUT_OF_RANGE.fullmatch(problem):
        problem = _out_of_range(match[1], match[2], name, _value_at(raw, path))
    for pattern, words in PROBLEMS.items():
        if match := re.fullmatch(pattern, problem):
            problem = words.format(*match.groups(), form=EXAMPLES.get(name), choices=choices)
    return f"{path}: {problem}" if path else problem


def _wrong_kind(expected: str, got: str, example: str | None) -> str:
    wanted, found = (
        " or ".join(KINDS.get(kind, kind) for kind in each.split(" | ")) for each in (expected, got)
    )
    advice = f"; as in {example}" if example else ""
    return f"{wanted} expected, not {found.partition(' (')[0]}{advice}"


def _out_of_range(comparison: str, limit: str, name: str, value: object) -> str:
    """Return which number is out of range, with its unit."""
    given = f"{value} " if isinstance(value, int | float) else ""
    unit = next((f" ({unit})" for end, unit in UNITS.items() if name.endswith(end)), "")
    return f"{given}must be {LIMITS[comparison]} {limit.removesuffix('.0')}{unit}"


def _value_at(raw: object, path: str) -> object:
    """Return the value at a path; None if the path lacks a key, as msgspec's does for mappings."""
    for name, index in re.findall(r"([^.\[\]]+)|\[([^]]*)\]", path):
        if isinstance(raw, dict):
            raw = raw.get(name)
        elif isinstance(raw, list) and index.isdecimal() and int(index) < len(raw):
            raw = raw[int(index)]
        else:
            return None
    return raw


def _unknown(wrong: str, path: str, struct: type[msgspec.Struct]) -> str:
    """Report an unknown setting, with a similar one or all known ones."""
    if wrong == "token":
        # Do not suggest a similar setting: the token must not be written into this file.
        return f"{path}.token: unknown setting; write the token into a file and set robot.token_file"
    known = [name for name, _ in settings_in(struct)]
    name = ".".join(filter(None, [_without_items(path), wrong]))
    elsewhere = sorted((at for at in known if at.rpartition(".")[2] == wrong), key=lambda at: at.count("."))
    others = [at for at in known if at != _without_items(path)]
    near = elsewhere or difflib.get_close_matches(name, others, n=1, cutoff=0.75)
    beside = ", ".join(at for at in known if at.rpartition(".")[0] == _without_items(path))
    advice = f"did you mean {near[0]}?" if near else f"there are {beside}"
    return f"{'.'.join(filter(None, [path, wrong]))}: unknown setting; {advice}"


def _without_items(path: str) -> str:
    """Return the path without indices and keys: elements of lists and mappings have the same settings."""
    return re.sub(r"\[[^]]*\]", "", path)


def settings_in(kind: Any, path: tuple[str, ...] = ()) -> Iterator[tuple[str, Any]]:
    """Yield the dotted names of all settings in a type, and their types."""
    if isinstance(kind, type) and issubclass(kind, msgspec.Struct):
        for name, inner in typing.get_type_hints(kind).items():
            yield ".".join((*path, name)), inner
            yield from settings_in(inner, (*path, name))
    for inner in typing.get_args(kind):
        yield from settings_in(inner, path)


def _choices(kind: Any) -> Iterator[object]:
    """Yield the values that a type lists."""
    if typing.get_origin(kind) is Literal:
        yield from typing.get_args(kind)
    else:
        for inner in typing.get_args(kind):
            yield from _choices(inner)
