"""Describes bytes in which no frame is found: for a pad that is down, for the doctor, for a search."""

from collections import Counter

from touchd.drivers.pad.format import PadFormat

# The largest share of unprintable characters in text: damage, or another encoding.
FEW_SHARE = 0.02
# With more, up to this, it is text with other bytes in it; of random bytes, two thirds are not printable.
SOME_SHARE = 0.3
EXCERPT_CHARACTERS, EXCERPT_BYTES = 60, 24


def is_text(data: bytes) -> bool:
    """Whether these bytes are printable text; text is never parsed as binary."""
    return bool(data) and _odd_share(data) <= FEW_SHARE


def has_text(data: bytes) -> bool:
    """Whether these bytes are lines of text with other bytes in them."""
    return b"\n" in data and FEW_SHARE < _odd_share(data) <= SOME_SHARE


def _odd_share(data: bytes) -> float:
    """Return the share of characters that are not printable."""
    counts = Counter(data.decode("utf-8", "replace"))
    odd = [each for each in counts if not (each.isprintable() or each in "\t\r\n\x1b") or each == "\ufffd"]
    return sum(counts[each] for each in odd) / max(counts.total(), 1)


def looks_like(data: bytes) -> str:
    """Say what bytes look like, with an excerpt: a line of text, or bytes in hex."""
    if not data:
        return "nothing"
    if not data.strip():
        return "only empty lines"
    if has_text(data):
        return f"text with other bytes in it, such as {data[-EXCERPT_BYTES:]!r}"
    if not is_text(data):
        return f"bytes that are not text, such as {data[-EXCERPT_BYTES:].hex(' ')}"
    lines = data[-4096:].decode("utf-8", "replace").splitlines()
    line = max(lines[1:-1] or lines, key=len, default="")[:EXCERPT_CHARACTERS]
    shown = "".join(each if each.isprintable() else " " for each in line).strip()
    return f"text, such as {shown!r}"


def why_no_frame(described: PadFormat, data: bytes) -> tuple[str, str]:
    """Return why bytes from a port hold no frame: the cause in a word or two, and a line for people."""
    return "no frames", f"no frame of {described} in {looks_like(data)}; touchd doctor says what to set"
