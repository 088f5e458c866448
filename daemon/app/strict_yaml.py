"""Reads YAML text strictly into a struct; a mistake is reported in one line that says where it is."""

from collections.abc import Hashable
from pathlib import Path
from typing import Any, TypeVar

import msgspec
import yaml

from touchd.drivers.errors import TouchdError

T = TypeVar("T", bound=msgspec.Struct)

MERGE_TAG = "tag:yaml.org,2002:merge"


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
                raise _problem(f"{key.value} has no value", key)
            seen.add(key.value)
        return super().construct_mapping(node, deep)


def _problem(what: str, place: Any) -> yaml.MarkedYAMLError:
    return yaml.constructor.ConstructorError(problem=what, problem_mark=place.start_mark)


def convert(file: Path, text: bytes, struct: type[T]) -> T:
    """Return the struct that a file's text describes; an empty one is all defaults. Raises ConfigError."""
    try:
        raw = StrictLoader(text).get_single_data()
    except yaml.MarkedYAMLError as error:
        from touchd.daemon.app.mistakes import explain_yaml

        raise ConfigError(f"{file}: {explain_yaml(error, text)}") from error
    except yaml.reader.ReaderError as error:
        line = len(text[: error.position + 1].splitlines())
        raise ConfigError(f"{file}: line {line}: {error.reason}; save the file as UTF-8 text") from error
    except (yaml.YAMLError, RecursionError, ValueError) as error:
        raise ConfigError(f"{file}: not YAML: {error}") from error
    try:
        return msgspec.convert({} if raw is None else raw, struct)
    except msgspec.ValidationError as error:
        from touchd.daemon.app.mistakes import explain

        raise ConfigError(f"{file}: {explain(str(error), struct, text)}") from error
