"""QiMessaging's values: bytes by a signature, such as `(sm)` for a text and a value of any kind."""

import struct
from collections.abc import Mapping
from functools import lru_cache
from typing import Any

NUMBERS = {kind: struct.Struct(f"<{code}") for kind, code in zip("bcCwWiIlLfd", "?bBhHiIqQfd", strict=True)}
# What a value of any kind is sent as.
SIGNATURES = {bool: "b", int: "i", float: "d", str: "s", list: "[m]", tuple: "[m]"}
# Of one message: a few bytes may claim any number of values.
MOST_VALUES, LONGEST_SIGNATURE = 10_000, 1000


def read(signature: str, data: bytes | bytearray) -> Any:
    """Return the value at the beginning of the data, maps as dicts; raises ValueError."""
    try:
        return _Reader(data).value(signature)
    except (TypeError, RecursionError) as error:
        raise ValueError(str(error)) from error


class _Reader:
    def __init__(self, data: bytes | bytearray) -> None:
        self._data = memoryview(data)
        self._left = MOST_VALUES

    def value(self, signature: str) -> Any:
        self._left -= 1
        if self._left < 0:
            raise ValueError("too many values")
        kind = signature[:1]
        if kind in NUMBERS:
            return self._number(kind)
        if kind == "s":
            return self._text()
        if kind == "m":
            return self.value(self._text())
        if kind == "[":
            (element,) = inside(signature)
            return [self.value(element) for _ in range(self._number("I"))]
        if kind == "{":
            return dict(self.value(f"[({signature[1:-1]})]"))
        if kind == "(":
            return tuple(self.value(member) for member in inside(signature))
        if kind == "v":
            return None
        raise ValueError(f"unknown signature {kind!r}")

    def _number(self, kind: str) -> Any:
        (number,) = NUMBERS[kind].unpack(self._take(NUMBERS[kind].size))
        return number

    def _text(self) -> str:
        return str(self._take(self._number("I")), errors="replace")

    def _take(self, size: int) -> memoryview:
        if size > len(self._data):
            raise ValueError(f"{size} bytes are missing")
        taken, self._data = self._data[:size], self._data[size:]
        return taken


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
    """Split what is in a signature's brackets; a note behind them, as in `(ff)<Point,x,y>`, is not sent."""
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
