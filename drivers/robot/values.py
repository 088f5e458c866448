"""Encodes and decodes QiMessaging's values by signature, such as `(sm)`: a text and a value of any kind."""

import itertools
import struct
from collections.abc import Mapping
from functools import lru_cache
from typing import Any

NUMBERS = {kind: struct.Struct(f"<{code}") for kind, code in zip("bcCwWiIlLfd", "?bBhHiIqQfd", strict=True)}
# The signature with which a value of any kind is sent.
SIGNATURES = {bool: "b", int: "i", float: "d", str: "s", list: "[m]", tuple: "[m]"}
# Limits of one message: a few bytes may claim any number of values.
MOST_VALUES, LONGEST_SIGNATURE = 20_000, 300


def read(signature: str, data: bytes | bytearray) -> Any:
    """Return the value at the beginning of the data, maps as dicts; raises ValueError."""
    rest, values = memoryview(data), itertools.count(1)

    def take(size: int) -> memoryview:
        nonlocal rest
        if size > len(rest):
            raise ValueError(f"{size} bytes are missing")
        taken, rest = rest[:size], rest[size:]
        return taken

    def value(signature: str) -> Any:
        if next(values) > MOST_VALUES:
            raise ValueError("too many values")
        kind = signature[:1]
        if kind in NUMBERS:
            return NUMBERS[kind].unpack(take(NUMBERS[kind].size))[0]
        if kind == "s":
            return str(take(value("I")), errors="replace")
        if kind == "m":
            return value(value("s"))
        if kind == "[":
            (element,) = inside(signature)
            return [value(element) for _ in range(value("I"))]
        if kind == "{":
            return dict(value(f"[({signature[1:-1]})]"))
        if kind == "(":
            return tuple(value(member) for member in inside(signature))
        if kind == "v":
            return None
        raise ValueError(f"unknown signature {kind!r}")

    try:
        return value(signature)
    except (TypeError, RecursionError) as error:
        raise ValueError(str(error)) from error


def write(signature: str, value: Any) -> bytes:
    """Return a value's bytes; raises ValueError or struct.error if it does not fit its signature."""
    kind = signature[:1]
    if kind in NUMBERS:
        return NUMBERS[kind].pack(value)
    if kind == "s" and isinstance(value, str):
        data = value.encode(errors="replace")
        return NUMBERS["I"].pack(len(data)) + data
    if kind == "m" and type(value) in SIGNATURES:
        own = SIGNATURES[type(value)]
        return write("s", own) + write(own, value)
    if kind == "[" and isinstance(value, list | tuple):
        (element,) = inside(signature)
        return NUMBERS["I"].pack(len(value)) + b"".join(write(element, each) for each in value)
    if kind == "{" and isinstance(value, Mapping):
        return write(f"[({signature[1:-1]})]", list(value.items()))
    if kind == "(" and isinstance(value, list | tuple):
        return b"".join(write(*pair) for pair in zip(inside(signature), value, strict=True))
    if kind == "v" and value is None:
        return b""
    raise ValueError(f"a {type(value).__name__} is not of the kind {signature[:20]!r}")


@lru_cache(64)
def inside(signature: str) -> tuple[str, ...]:
    """Split the inside of a signature's brackets; an annotation, as in `(ff)<Point,x,y>`, is not sent."""
    if len(signature) > LONGEST_SIGNATURE:
        raise ValueError("the signature is too long")
    found: list[str] = []
    begin, opened = 1, 0
    for end, letter in enumerate(signature, 1):
        opened += (letter in "[{(<") - (letter in "]})>")
        if opened == 0:
            return tuple(found)
        if opened == 1 and end > 1 and signature[end : end + 1] != "<":
            found.append(signature[begin:end])
            begin = end
    raise ValueError("a bracket of the signature is open")
