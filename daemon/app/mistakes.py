"""Explains what is wrong with a setting, where, and what it may be; imported only after a mistake."""

import difflib
import re
import typing
from collections.abc import Iterator
from typing import Any, Literal

import msgspec
import yaml

UNKNOWN = re.compile(r"Object contains unknown field `(.*)`")
MISSING = re.compile(r"Object missing required field `(.*)`")
WRONG_KIND = re.compile(r"Expected `(.*)`, got `(.*)`")
OUT_OF_RANGE = re.compile(r"Expected `(?:int|float)` ([<>]=?.*)")
WRONG_LENGTH = re.compile(r"Expected `array` of length (\d+), got (\d+)")
EMPTY = re.compile(r"Expected `(?:str|array)` of length >= 1")
WRONG_FORM = "Expected `str` matching regex "
WRONG_CHOICE = re.compile(r"Invalid enum value (.*)")
# msgspec's names of types, in words.
KINDS = {
    "object": "settings (name: value)",
    "array": "a list (- item)",
    "str": "text (in quotes)",
    "int": "a whole number",
    "float": "a number",
    "bool": "true or false",
}
# Settings whose text has a certain form.
FORMS = {
    "discovery": "discovery: homeassistant",
    "host": "host: broker.local",
    "namespace": "namespace: /touchd",
    "topic": "topic: lab/nao1",
    "url": "url: ws://robot:9090",
}
# Sections that look as if they took a single value.
EXAMPLES = {
    "words": "words: {stroke: {name: caress, phrase: a caress}}",
    "journal": "journal: {path: events.jsonl}",
    "leds": "leds: {color: green}",
    "live": "live: {port: 8054}",
    "lsl": "lsl: {name: touchd}",
    "mqtt": "mqtt: {host: broker.local}",
    "robot": "robot: {url: 'tcp://nao.local:9559'}",
    "rosbridge": "rosbridge: {url: 'ws://robot:9090'}",
    "ros2": "ros2: {domain: 0}",
    "scene": "scene: {speak_above: 0.65}",
    "sensor": "sensor: {port: /dev/ttyACM0}",
}

# Parts of PyYAML's messages, and what is wrong in each case.
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
# Not spaces to YAML: a no-break space is part of a name or a value.
INVISIBLE = re.compile("[\u00a0\u2002-\u200b\u202f\u2060\ufeff]")


def explain_yaml(error: yaml.MarkedYAMLError, text: bytes) -> str:
    """Say where a text is not YAML and why, in words for somebody who does not know YAML."""
    mark = error.problem_mark or error.context_mark
    where = f"line {mark.line + 1}, column {mark.column + 1}: " if mark else ""
    problem = str(error.problem)
    if problem.endswith("has no value"):
        problem += "; write null for none, {} for the defaults; a list is [a, b], a fraction 0.5"
    problem = next((words for part, words in YAML_PROBLEMS.items() if part in problem), problem)
    return where + problem + _invisible(text)


def _invisible(text: bytes) -> str:
    """Point out a character that looks like a space but is none, as pages and mails have."""
    lines = text.decode(errors="replace").removeprefix("\ufeff").splitlines()
    for number, line in enumerate(lines, 1):
        if found := INVISIBLE.search(line.partition("#")[0]):
            what = f"U+{ord(found[0]):04X}, perhaps copied from a page"
            return f"; line {number} has an invisible character ({what}): type its spaces again"
    return ""


def explain(error: str, struct: type[msgspec.Struct], text: bytes) -> str:
    """Turn the text of a msgspec.ValidationError about a struct into one line for the user."""
    return _explain(error, struct) + _invisible(text)


def _explain(error: str, struct: type[msgspec.Struct]) -> str:
    problem, _, where = error.rpartition(" - at `")
    if not problem:
        problem, where = where, ""
    path = where.removesuffix("`").removeprefix("key` in `").removeprefix("$").removeprefix(".")
    if match := UNKNOWN.fullmatch(problem):
        return _unknown(match[1], path, struct)
    if match := MISSING.fullmatch(problem):
        problem = f"{match[1]} is missing"
    elif match := WRONG_KIND.fullmatch(problem):
        expected, got = (
            " or ".join(KINDS.get(kind, kind) for kind in each.split(" | ")) for each in match.groups()
        )
        problem = f"{expected} expected, not {got.partition(' (')[0]}"
        if example := EXAMPLES.get(_without_items(path).rpartition(".")[2]):
            problem += f"; as in {example}"
    elif match := WRONG_LENGTH.fullmatch(problem):
        problem = f"{match[1]} values expected, not {match[2]}"
    elif problem == "Expected `str`":
        problem = "a name before a colon is not text; put it in quotes if it is a number or on, off, yes, no"
    elif EMPTY.fullmatch(problem):
        problem = "must not be empty"
    elif problem.startswith(WRONG_FORM):
        problem = f"another form expected, as in {FORMS[path.rpartition('.')[2]]}"
    elif match := OUT_OF_RANGE.fullmatch(problem):
        problem = f"must be {match[1]}"
    elif match := WRONG_CHOICE.fullmatch(problem):
        choices = (kind for name, kind in _settings(struct) if name == _without_items(path))
        listed = ", ".join(str(choice) for kind in choices for choice in _choices(kind))
        problem = f"{match[1]} is not one of {listed}"
    return f"{path}: {problem}" if path else problem


def _unknown(wrong: str, path: str, struct: type[msgspec.Struct]) -> str:
    """Report an unknown setting, with a similar one or all known ones."""
    if wrong == "token":
        # Do not suggest a similar setting: the token must not be written into this file.
        return f"{path}.token: unknown setting; write the token into a file and set robot.token_file"
    known = [name for name, _ in _settings(struct)]
    name = ".".join(filter(None, [_without_items(path), wrong]))
    elsewhere = sorted((at for at in known if at.rpartition(".")[2] == wrong), key=lambda at: at.count("."))
    others = [at for at in known if at != _without_items(path)]
    near = elsewhere or difflib.get_close_matches(name, others, n=1, cutoff=0.75)
    beside = ", ".join(at.rpartition(".")[2] for at in known if at.rpartition(".")[0] == _without_items(path))
    advice = f"did you mean {near[0]}?" if near else f"there are {beside}"
    return f"{'.'.join(filter(None, [path, wrong]))}: unknown setting; {advice}"


def _without_items(path: str) -> str:
    """Return the path without indices and keys: elements of lists and mappings have the same settings."""
    return re.sub(r"\[[^]]*\]", "", path)


def _settings(kind: Any, path: tuple[str, ...] = ()) -> Iterator[tuple[str, Any]]:
    """Yield the dotted names of all settings in a type, and their types."""
    if isinstance(kind, type) and issubclass(kind, msgspec.Struct):
        for name, inner in typing.get_type_hints(kind).items():
            yield ".".join((*path, name)), inner
            yield from _settings(inner, (*path, name))
    for inner in typing.get_args(kind):
        yield from _settings(inner, path)


def _choices(kind: Any) -> Iterator[object]:
    """Yield the values that a type lists."""
    if typing.get_origin(kind) is Literal:
        yield from typing.get_args(kind)
    else:
        for inner in typing.get_args(kind):
            yield from _choices(inner)
