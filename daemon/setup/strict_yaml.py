"""Reads YAML text strictly into a struct; a mistake in it is told in one line."""

import difflib
import logging
import re
import reprlib
import typing
from collections.abc import Hashable, Mapping
from typing import Any, Literal, TypeVar

import msgspec
import yaml

T = TypeVar("T", bound=msgspec.Struct)
log = logging.getLogger(__name__)
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


class StrictLoader(yaml.SafeLoader):
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


def convert(text: bytes | str, struct: type[T], renamed: Mapping[str, Mapping[str, str]]) -> T:
    """Return the struct that YAML text describes; an empty text is all defaults. Raises StrictYamlError.

    renamed: by section, the previous release's names of settings and the current ones.
    """
    try:
        loader = StrictLoader(text)
        raw = loader.get_single_data()
    except yaml.MarkedYAMLError as error:
        raise StrictYamlError(_plain_syntax(error)) from error
    except yaml.reader.ReaderError as error:
        line = len(text[: error.position + 1].splitlines())
        raise StrictYamlError(
            f"not YAML: line {line}: {error.reason}; save the file as UTF-8 text"
        ) from error
    except (yaml.YAMLError, RecursionError, ValueError) as error:
        raise StrictYamlError(f"not YAML: {' '.join(str(error).split())}") from error
    if isinstance(raw, dict):
        _rename(raw, renamed)
    try:
        converted = msgspec.convert({} if raw is None else raw, struct)
    except msgspec.ValidationError as error:
        raise StrictYamlError(_plainly(str(error), raw, struct)) from error
    for empty in loader.empty:
        log.warning("configuration, %s is empty, so not used; {} takes its defaults", empty)
    return converted


def _rename(raw: dict[Any, Any], renamed: Mapping[str, Mapping[str, str]]) -> None:
    """Accept names of the previous release, with a warning each."""
    for name, settings in renamed.items():
        section = raw.get(name)
        if not isinstance(section, dict):
            continue
        for old, new in settings.items():
            if old in section and new not in section:
                log.warning(
                    "%s.%s is now called %s.%s; rename it, the next release refuses it", name, old, name, new
                )
                section[new] = section.pop(old)


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
        name, value = f"a name in {name or 'the file'}", list(value)
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
