"""QiMessaging's values: bytes by a signature, such as `(sm)` for a text and a value of any kind."""

import struct
from collections.abc import Mapping
from functools import lru_cache

NUMBERS = {kind: struct.Struct(f"<{code}") for kind, code in zip("bcCwWiIlLfd", "?bBhHiIqQfd", strict=True)}
SIZE = struct.Struct("<I")
LONGEST_SIGNATURE, MOST_NESTED = 1000, 32
# Memory that the values of one message may take: each beside its text, and all together. A few bytes may
# claim any number of values.
VALUE_BYTES, MOST_BYTES = 100, 1_500_000
# A character takes up to this many bytes in Python.
CHARACTER_BYTES = 4


class ValueFault(Exception):  # noqa: N818 - it may be the robot's or ours, and is handled
    """Bytes are not what their signature says, or a value does not fit its signature."""


def read(signature: str, data: bytes | bytearray) -> object:
    """Return the value at the beginning of the data; raises ValueFault.

    Maps become dicts, tuples stay tuples. What follows the value is ignored.
    """
    try:
        return _Reader(data).value(signature, 0)
    except (ValueError, TypeError, struct.error) as error:
        raise ValueFault(f"{signature[:20]!r} cannot be read: {error}") from error


def write(signature: str, value: object) -> bytes:
    """Return a value's bytes; raises ValueFault."""
    try:
        return _written(signature, value)
    except (ValueError, TypeError, struct.error) as error:
        raise ValueFault(f"{signature[:20]!r} cannot be written: {error}") from error


class _Reader:
    def __init__(self, data: bytes | bytearray) -> None:
        self._data = data
        self._at = 0
        self._room = MOST_BYTES

    def value(self, signature: str, depth: int) -> object:
        self._room -= VALUE_BYTES
        if self._room < 0 or depth > MOST_NESTED:
            raise ValueError("too many values")
        kind = signature[:1]
        if kind in NUMBERS:
            (number,) = NUMBERS[kind].unpack(self._take(NUMBERS[kind].size))
            return number
        if kind == "s":
            return self._take(self._size()).decode(errors="replace")
        if kind == "r":
            return bytes(self._take(self._size()))
        if kind == "m":
            (own,) = parts(self._take(self._size()).decode())
            return self.value(own, depth + 1)
        if kind == "[":
            (element,) = parts(signature[1:-1])
            return [self.value(element, depth + 1) for _ in range(self._size())]
        if kind == "{":
            key, of_key = parts(signature[1:-1])
            return {self.value(key, depth + 1): self.value(of_key, depth + 1) for _ in range(self._size())}
        if kind == "(":
            return tuple(self.value(member, depth + 1) for member in members(signature))
        if kind == "v":
            return None
        raise ValueError(f"unknown signature {kind!r}")

    def _size(self) -> int:
        (size,) = SIZE.unpack(self._take(SIZE.size))
        return int(size)

    def _take(self, size: int) -> bytes | bytearray:
        self._room -= CHARACTER_BYTES * size
        if self._room < 0 or size > len(self._data) - self._at:
            raise ValueError(f"{size} bytes are missing, or too many")
        self._at += size
        return self._data[self._at - size : self._at]


def _written(signature: str, value: object) -> bytes:
    kind = signature[:1]
    if kind in NUMBERS:
        wanted = bool if kind == "b" else (int, float) if kind in "fd" else int
        if isinstance(value, wanted) and isinstance(value, bool) == (kind == "b"):
            return NUMBERS[kind].pack(value)
    elif kind == "s" and isinstance(value, str):
        data = value.encode(errors="replace")
        return SIZE.pack(len(data)) + data
    elif kind == "m":
        own = signature_of(value)
        return _written("s", own) + _written(own, value)
    elif kind == "[" and isinstance(value, list | tuple):
        (element,) = parts(signature[1:-1])
        return SIZE.pack(len(value)) + b"".join(_written(element, each) for each in value)
    elif kind == "{" and isinstance(value, Mapping):
        key, of_key = parts(signature[1:-1])
        pairs = (_written(key, each) + _written(of_key, of) for each, of in value.items())
        return SIZE.pack(len(value)) + b"".join(pairs)
    elif kind == "(" and isinstance(value, list | tuple):
        return b"".join(_written(*pair) for pair in zip(members(signature), value, strict=True))
    elif kind == "v" and value is None:
        return b""
    raise TypeError(f"a {type(value).__name__} is not of this kind")


def signature_of(value: object) -> str:
    """Return the signature of a builtin value; raises TypeError for others."""
    if isinstance(value, int) and not isinstance(value, bool):
        return "i" if -(2**31) <= value < 2**31 else "l"
    signatures = {bool: "b", float: "d", str: "s", list: "[m]", tuple: "[m]", dict: "{mm}", type(None): "v"}
    try:
        return signatures[type(value)]
    except KeyError:
        raise TypeError(f"no signature for a {type(value).__name__}") from None


def members(signature: str) -> tuple[str, ...]:
    """Return the signatures of a tuple's members; a note behind it, as in `(ff)<Point,x,y>`, is not sent."""
    return parts(signature[1 : signature.rindex(")")])


@lru_cache(64)
def parts(signature: str) -> tuple[str, ...]:
    """Split signatures that follow one another; raises ValueError."""
    if len(signature) > LONGEST_SIGNATURE:
        raise ValueError("the signature is too long")
    found: list[str] = []
    begin = opened = 0
    for end, letter in enumerate(signature, 1):
        opened += (letter in "[{(<") - (letter in "]})>")
        if opened == 0 and signature[end : end + 1] != "<":
            found.append(signature[begin:end])
            begin = end
    if opened != 0:
        raise ValueError("a bracket of the signature is open")
    return tuple(found)
