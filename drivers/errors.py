"""What every error at an edge has in common: a person can put it right."""

from collections.abc import Iterator
from contextlib import contextmanager


class TouchdError(Exception):
    """Something outside touchd is wrong: a file, a device, a setting, a network.

    The message is one line that says what is wrong, where, and what to do; the command line shows just that.
    """


@contextmanager
def os_errors_as(kind: type[TouchdError], what: str, advice: str = "") -> Iterator[None]:
    """Raise an OSError as an error of ours: what cannot be done, why, and what to do."""
    try:
        yield
    except OSError as error:
        raise kind(f"{what} ({error.strerror}){advice and f'; {advice}'}") from error
