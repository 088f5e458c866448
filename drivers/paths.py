"""Paths as people write them in settings."""

from pathlib import Path

from touchd.drivers.errors import TouchdError


class PathError(TouchdError):
    """A path begins with an unknown home."""


def written_out(path: str) -> Path:
    """Expand ~ and ~name at the beginning of a path; raises PathError if there is no such home."""
    try:
        return Path(path).expanduser()
    except RuntimeError as error:
        raise PathError(f"{path}: unknown home; write the whole path from / on") from error
