"""Paths as people write them in settings."""

from pathlib import Path

from touchd.drivers.errors import TouchdError


class PathError(TouchdError):
    """A path begins with a home that is not known."""


def written_out(path: str) -> Path:
    """Return a path with its ~ or ~name replaced by that home; raises PathError where there is none."""
    try:
        return Path(path).expanduser()
    except RuntimeError as error:
        raise PathError(f"{path}: no such home is known; write the whole path, from / on") from error
