"""Reads YAML text strictly into a struct; a mistake in it is told in one line."""

import difflib
import logging
import re
import reprlib
import typing
from collections.abc import Hashable, Mapping
from typing import Any, Literal, NamedTuple, TypeVar

import msgspec
import yaml

T = TypeVar("T", bound=msgspec.Struct)
log = logging.getLogger(__name__)

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


class _Place(NamedTuple):
    """Where a mistake is: the names that lead there, its value and type, and the section that it is in."""

    names: tuple[str, ...]
    value: Any
    kind: Any
    section: type[msgspec.Struct]


def _place(where: str, raw: Any, struct: type[msgspec.Struct]) -> _Place:
    """Return the place that msgspec calls $.actions[0].above; a name in a mapping it calls [...]."""
    at = _Place((), raw, struct, struct)
    for name, index in re.findall(r"\.(\w+)|\[(\d+|\.\.\.)\]", where):
        if name:
            section = _section(at.kind)
            kind = typing.get_type_hints(section, include_extras=True)[name]
            at = _Place((*at.names, name), at.value.get(name), kind, section)
        elif index == "...":
            kind = next(
                typing.get_args(part)[1] for part in _parts(at.kind) if typing.get_origin(part) is dict
            )
            key = next(key for key, value in at.value.items() if not _is(value, kind))
            at = _Place((*at.names, key), at.value[key], kind, at.section)
        else:
            at = at._replace(value=at.value[int(index)])
    return at


def _is(value: Any, kind: Any) -> bool:
    try:
        msgspec.convert(value, kind)
    except msgspec.ValidationError:
        return False
    return True


def _plainly(message: str, raw: Any, struct: type[msgspec.Struct]) -> str:
    """Turn msgspec's message into one that names the setting, the allowed values and the given one."""
    problem, _, where = message.partition(" - at `")
    at = _place(where, raw, struct)
    name, value = ".".join(at.names), at.value
    if where.startswith("key`"):
        name, value = f"a name in {name or 'the file'}", list(value)
    if unknown := re.fullmatch(r"Object contains unknown field `(.*)`", problem):
        return _unknown_key(at, unknown[1], struct)
    if missing := re.fullmatch(r"Object missing required field `(.*)`", problem):
        return f"{'.'.join((*at.names, missing[1]))} is missing and has no default"
    if value is None and name:
        return f"{name} is empty; give it a value, or leave it out"
    if problem.startswith("Invalid enum value"):
        literals = [part for part in _parts(at.kind) if typing.get_origin(part) is Literal]
        choices = " or ".join(str(choice) for literal in literals for choice in typing.get_args(literal))
        return f"{name} must be {choices}, not {_shortly(value)}"
    if expected := re.fullmatch(r"Expected `(.*?)`(.*?)(, got .*)?", problem):
        kinds = " or ".join(PLAIN_WORDS.get(kind, kind) for kind in expected[1].split(" | "))
        how = expected[2]
        if how.startswith(" matching regex"):
            default = getattr(at.section(), at.names[-1])
            how = f" such as {default}" if default else " in another form"
        hint = "; put it in quotes" if kinds == "text" and isinstance(value, int | float) else ""
        return f"{name or 'the file'} must be {kinds}{how}, not {_shortly(value)}{hint}"
    return f"{name}: {problem}" if name else problem


def _unknown_key(at: _Place, wrong: str, struct: type[msgspec.Struct]) -> str:
    if wrong == "token":
        # A hint at a similar setting would have the token written there, and shown.
        return "robot.token is not a setting: put the token into a file of its own and name it in token_file"
    homes = [
        name
        for name, kind in typing.get_type_hints(struct).items()
        if (name,) != at.names
        and typing.get_origin(kind) is not dict
        and wrong in _section(kind).__struct_fields__
    ]
    known = _section(at.kind).__struct_fields__
    if homes:
        advice = f"it belongs under {' or '.join(homes)}:"
    elif near := difflib.get_close_matches(wrong, known, n=1, cutoff=0.5):
        advice = f"did you mean {near[0]}?"
    else:
        advice = f"known here: {', '.join(known)}"
    return f"{'.'.join((*at.names, wrong))} is not a setting; {advice}"


def _section(kind: Any) -> type[msgspec.Struct]:
    """Return the section that a type describes; one without settings where it describes none."""
    sections = (part for part in _parts(kind) if isinstance(part, type) and issubclass(part, msgspec.Struct))
    return next(sections, msgspec.Struct)


def _parts(hint: Any) -> list[Any]:
    """Return a type and its components: `tuple[A, ...] | None` holds A."""
    return [hint, *(part for argument in typing.get_args(hint) for part in _parts(argument))]


def _shortly(value: Any) -> str:
    # Two levels are enough to recognise a value; deeper ones could be huge.
    short = reprlib.Repr()
    short.maxlevel = 2
    return short.repr(value)
