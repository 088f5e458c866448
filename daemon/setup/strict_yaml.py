"""Reads YAML text strictly into a struct; a mistake is reported in one line that says where it is."""

import difflib
import re
import typing
from collections.abc import Hashable, Iterator
from typing import Any, TypeVar

import msgspec
import yaml

T = TypeVar("T", bound=msgspec.Struct)

MERGE_TAG = "tag:yaml.org,2002:merge"
UNKNOWN_FIELD = "Object contains unknown field `"


class StrictYamlError(Exception):
    """The text is not YAML, or not what the struct asks for; the message is one line."""


class StrictLoader(yaml.SafeLoader):
    """Refuses aliases and merge keys, duplicate keys, and keys without a value.

    A few hundred bytes of aliases can expand to gigabytes. Of duplicate keys YAML silently takes the last. A
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
                raise _problem(f"{key.value} has no value; write null for none, {{}} for the defaults", key)
            seen.add(key.value)
        return super().construct_mapping(node, deep)


def _problem(what: str, place: Any) -> yaml.MarkedYAMLError:
    return yaml.constructor.ConstructorError(problem=what, problem_mark=place.start_mark)


def convert(text: bytes | str, struct: type[T]) -> T:
    """Return the struct that YAML text describes; an empty text is all defaults. Raises StrictYamlError."""
    try:
        raw = StrictLoader(text).get_single_data()
    except yaml.MarkedYAMLError as error:
        mark = error.problem_mark or error.context_mark
        where = f"line {mark.line + 1}, column {mark.column + 1}: " if mark else ""
        raise StrictYamlError(f"{where}{error.problem}") from error
    except yaml.reader.ReaderError as error:
        line = len(text[: error.position + 1].splitlines())
        raise StrictYamlError(f"line {line}: {error.reason}; save the file as UTF-8 text") from error
    except (yaml.YAMLError, RecursionError, ValueError) as error:
        raise StrictYamlError(f"not YAML: {error}") from error
    try:
        return msgspec.convert({} if raw is None else raw, struct)
    except msgspec.ValidationError as error:
        problem, _, where = str(error).rpartition(" - at `")
        if not problem:
            problem, where = where, ""
        raise StrictYamlError(_with_place(problem, where.removesuffix("`"), struct)) from error


def _with_place(problem: str, where: str, struct: type[msgspec.Struct]) -> str:
    """Return msgspec's message after the setting's path; for an unknown setting, with a similar one."""
    path = where.removeprefix("key` in `").removeprefix("$").removeprefix(".")
    if not problem.startswith(UNKNOWN_FIELD):
        return f"{path}: {problem}" if path else problem
    wrong = problem.removeprefix(UNKNOWN_FIELD).removesuffix("`")
    if wrong == "token":
        # A token must not get into this file by way of a similar setting.
        return f"{path}.token: unknown setting; write the token into a file and set robot.token_file"
    known = list(_names(struct))
    # Elements of lists and of mappings have the same settings.
    name = ".".join(filter(None, [re.sub(r"\[[^]]*\]", "", path), wrong]))
    elsewhere = sorted((at for at in known if at.rpartition(".")[2] == wrong), key=len)
    near = elsewhere or difflib.get_close_matches(name, known, n=1, cutoff=0.75)
    advice = f"; did you mean {near[0]}?" if near else ""
    return f"{'.'.join(filter(None, [path, wrong]))}: unknown setting{advice}"


def _names(kind: Any, path: tuple[str, ...] = ()) -> Iterator[str]:
    """Yield the dotted names of all settings in a type."""
    if isinstance(kind, type) and issubclass(kind, msgspec.Struct):
        for name, inner in typing.get_type_hints(kind).items():
            yield ".".join((*path, name))
            yield from _names(inner, (*path, name))
    for inner in typing.get_args(kind):
        yield from _names(inner, path)
