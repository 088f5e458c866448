"""YAML text into a typed struct; whatever does not fit is said in one line that names the setting."""

from __future__ import annotations

import difflib
import re
import reprlib
import typing
from collections.abc import Hashable
from typing import Any, Literal, TypeVar

import msgspec
import yaml

T = TypeVar("T", bound=msgspec.Struct)
Keys = tuple[str, ...]

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


class _StrictLoader(yaml.SafeLoader):
    """A key given twice is an error, where YAML would let the last one win in silence."""

    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict[Hashable, Any]:
        seen: set[str] = set()
        for key, _ in node.value:
            if isinstance(key, yaml.ScalarNode):
                if key.value in seen:
                    raise yaml.constructor.ConstructorError(
                        problem=f"{key.value} is set twice", problem_mark=key.start_mark
                    )
                seen.add(key.value)
        return super().construct_mapping(node, deep)


def convert(text: bytes | str, struct: type[T]) -> T:
    """Return the struct that YAML text describes; an empty text is all defaults. Raises StrictYamlError."""
    try:
        raw = yaml.load(text, _StrictLoader)
    except yaml.MarkedYAMLError as error:
        where = f"line {error.problem_mark.line + 1}: " if error.problem_mark else ""
        raise StrictYamlError(f"{where}{error.problem}") from error
    except (yaml.YAMLError, RecursionError, ValueError) as error:
        raise StrictYamlError(f"not YAML: {' '.join(str(error).split())}") from error
    try:
        return msgspec.convert({} if raw is None else raw, struct)
    except msgspec.ValidationError as error:
        raise StrictYamlError(_plainly(str(error), raw, struct)) from error


def _plainly(message: str, raw: Any, struct: type[msgspec.Struct]) -> str:
    """Turn msgspec's message into one that names the setting, what may stand there and what does."""
    problem, _, where = message.partition(" - at `")
    keys = tuple(re.findall(r"\.(\w+)", where))
    name = ".".join(keys)
    unknown = re.fullmatch(r"Object contains unknown field `(.*)`", problem)
    if unknown:
        return _unknown_key(keys, unknown[1], struct)
    missing = re.fullmatch(r"Object missing required field `(.*)`", problem)
    if missing:
        return f"{'.'.join((*keys, missing[1]))} is missing and has no default"
    if problem.startswith("Invalid enum value"):
        return f"{name} must be {_choices(struct, keys)}, not {_shortly(_value(raw, keys))}"
    expected = re.fullmatch(r"Expected `(.*?)`(.*?)(, got .*)?", problem)
    if expected:
        kinds = " or ".join(PLAIN_WORDS.get(kind, kind) for kind in expected[1].split(" | "))
        return f"{name or 'the file'} must be {kinds}{expected[2]}, not {_shortly(_value(raw, keys))}"
    return f"{name}: {problem}" if name else problem


def _unknown_key(keys: Keys, wrong: str, struct: type[msgspec.Struct]) -> str:
    known = _section(struct, keys).__struct_fields__
    near = difflib.get_close_matches(wrong, known, n=1, cutoff=0.5)
    advice = f"did you mean {near[0]}?" if near else f"known here: {', '.join(known)}"
    return f"{'.'.join((*keys, wrong))} is not a setting; {advice}"


def _choices(struct: type[msgspec.Struct], keys: Keys) -> str:
    """Return the words that a Literal setting may be, as a list for people."""
    hint = typing.get_type_hints(_section(struct, keys[:-1]))[keys[-1]]
    literals = [part for part in _parts(hint) if typing.get_origin(part) is Literal]
    return " or ".join(str(choice) for literal in literals for choice in typing.get_args(literal))


def _section(struct: type[msgspec.Struct], keys: Keys) -> type[msgspec.Struct]:
    for key in keys:
        parts = _parts(typing.get_type_hints(struct)[key])
        struct = next(part for part in parts if isinstance(part, type) and issubclass(part, msgspec.Struct))
    return struct


def _parts(hint: Any) -> list[Any]:
    """Return a type and all that it is made of: `tuple[A, ...] | None` holds A."""
    return [hint, *(part for argument in typing.get_args(hint) for part in _parts(argument))]


def _value(raw: Any, keys: Keys) -> Any:
    for key in keys:
        raw = raw.get(key) if isinstance(raw, dict) else raw
    return raw


def _shortly(value: Any) -> str:
    # Two levels are enough to recognise a value, and nested aliases could make a third astronomic.
    short = reprlib.Repr()
    short.maxlevel = 2
    return short.repr(value)
