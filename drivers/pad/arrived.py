"""Describes bytes in which no frame is found: for a pad that is down, for the doctor, for a search."""

# Bytes that are not printable: damage, or another encoding.
FEW_SHARE = 0.02
EXCERPT_CHARACTERS, EXCERPT_BYTES = 60, 24


def is_text(data: bytes) -> bool:
    """Whether these bytes are printable text; text is never parsed as binary."""
    characters = data.decode("utf-8", "replace")
    wrong = sum(not (each.isprintable() or each in "\t\r\n\x1b") or each == "\ufffd" for each in characters)
    return bool(data) and wrong <= FEW_SHARE * len(characters)


def looks_like(data: bytes) -> str:
    """Say what bytes look like, with an excerpt: a line of text, or bytes in hex."""
    if not data:
        return "nothing"
    if not is_text(data):
        return f"bytes that are not text, such as {data[-EXCERPT_BYTES:].hex(' ')}"
    lines = data[-4096:].decode("utf-8", "replace").splitlines()
    line = max(lines[1:-1] or lines, key=len, default="")[:EXCERPT_CHARACTERS]
    shown = "".join(each if each.isprintable() else " " for each in line).strip()
    return f"text, such as {shown!r}"
