"""How a robot is reached: its address and login, time limits, and what a session can do."""

import re
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Literal, Protocol, TypeAlias

import msgspec

from touchd.drivers.errors import MAX_LINE_BYTES, TouchdError, reason
from touchd.drivers.whole_file import secret_in

# NAOqi's ports, up to 2.8 and from 2.9 on.
PORTS = {"tcp": 9559, "tcps": 9503}
# To be called repeatedly during a wait; raises TimeoutError once it has taken too long.
GoOn: TypeAlias = Callable[[], None]
ADDRESS = re.compile(r"(?:(tcps?)://)?(\[[^\s\[\]]+\]|[^\s/@:\[\]]+)(?::(\d{0,5}))?", re.IGNORECASE)
# Limit for a call once the daemon stops; three of them fit into the two seconds it has for that.
STOPPING_LIMIT_S = 0.25


class RobotError(TouchdError):
    """The robot cannot be used as configured: the user must change something. The message is one line."""


class RobotLost(Exception):  # noqa: N818 - says what happened; it is handled, never shown as an error
    """The robot is gone or answers too late (a call may still run there); only a new session helps."""


class RobotRefused(Exception):  # noqa: N818 - as above
    """The robot answered with an error, or has no such service or method; the session goes on."""


@dataclass(frozen=True, kw_only=True)
class RobotLimits:
    """Every limit of the link to the robot.

    connect_s: for a connection, or for finding a service. call_s: for any call on the event path. action_s:
    for one action, whose call returns when it is over; a dance takes minutes. stale_s: what has waited longer
    is dropped, since a late answer is worse than none. heartbeat_s: how often an idle robot is called, as a
    hung one still looks connected. capacity: most waiting messages, or reactions; the oldest is dropped.
    """

    connect_s: float = 3.0
    call_s: float = 1.0
    action_s: float = 600.0
    stale_s: float = 2.0
    heartbeat_s: float = 0.3
    capacity: int = 64


@contextmanager
def waiting(what: str, limit_s: float, stopping: threading.Event) -> Iterator[GoOn]:
    """Limit a wait for the robot; turn errors into RobotLost or RobotRefused that say what was waited for."""
    begun_s = time.monotonic()

    def go_on() -> None:
        waited_s = time.monotonic() - begun_s
        if waited_s >= limit_s or (stopping.is_set() and waited_s >= STOPPING_LIMIT_S):
            raise TimeoutError(f"no answer within {limit_s:g} s")

    try:
        yield go_on
    except RobotRefused as error:
        # A robot's message may be long, and have several lines.
        raise RobotRefused(f"{what}: {' '.join(str(error)[:MAX_LINE_BYTES].split())}") from error
    except (OSError, OverflowError, TouchdError) as error:
        raise RobotLost(f"{what}: {reason(error)}") from error


class RobotSettings(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """The robot's address, and its login if token_file is given. The token itself is never a setting.

    user: None is nao. certificate: fingerprint of the robot's certificate, sha256:HEX, or "any"; a token
    needs it. client: "qi" uses the robot's own library instead of `wire`.
    """

    url: str
    prefix: str = "TouchGesture"
    user: str | None = None
    token_file: str | None = None
    certificate: str | None = None
    client: Literal["touchd", "qi"] = "touchd"

    def __post_init__(self) -> None:
        if not re.fullmatch(r"(?!AL)\w+", self.prefix):
            raise ValueError(f"prefix {self.prefix!r} must be one word and not begin with AL, as the robot's")
        if self.token_file is not None and "/" not in self.token_file:
            raise ValueError("token_file is not a full path; write the token into a file and give its path")
        if self.user is not None and self.token_file is None:
            raise ValueError("user lacks its token; set token_file to a file with it, or leave user out")
        if self.address[0] != "tcps" and (self.token_file or self.certificate):
            raise ValueError(f"url {self.url}: what is sent there is not encrypted; use tcps://")
        if self.client == "qi" and self.pinned:
            raise ValueError("qi accepts any certificate; leave client out, or certificate")

    @property
    def pinned(self) -> str | None:
        """The fingerprint that the robot must show, sha256HEX without openssl's colons; None for any."""
        return None if self.certificate in (None, "any") else self.certificate.replace(":", "").lower()

    @property
    def address(self) -> tuple[str, str, int]:
        """The robot's scheme, tcp if the URL names none, host and port."""
        parts = ADDRESS.fullmatch(self.url.strip())
        if parts is None or int(parts[3] or 1) not in range(1, 65536):
            # What is before an @ may be a password.
            shown = re.sub(r"//.*@", "//***@", self.url)
            raise ValueError(f"{shown!r} is not a robot's name or address, such as nao.local")
        scheme = (parts[1] or "tcp").lower()
        return scheme, parts[2].strip("[]"), int(parts[3] or PORTS[scheme])

    def login(self) -> dict[str, str]:
        """Return user and token, {} without token_file; raises RobotError, also for an exposed token."""
        if self.token_file is None:
            return {}
        token = secret_in(self.token_file, "robot.token_file", RobotError)
        if not self.certificate:
            why = f"robot {self.url}: whoever answers there would get the token; set robot.certificate"
            raise RobotError(f"{why} to its own, which touchd doctor shows, or any if nobody else can answer")
        return {"user": self.user or "nao", "token": token}


class RobotSession(Protocol):
    """One connection to a robot, for one thread; after RobotLost it can only be closed."""

    def connect(self) -> None:
        """Connect and log in; raises RobotLost or RobotRefused."""

    def connected(self) -> bool:
        """Return False as soon as the connection is known to be lost; True for a hung robot."""

    def call(self, service: str, method: str, *arguments: object, limit_s: float) -> object:
        """Call a service with builtin types and return its answer; raises RobotLost or RobotRefused."""

    def close(self) -> None:
        """Drop the connection at once; idempotent."""


# The event is set when the daemon stops; then no call may take longer than STOPPING_LIMIT_S.
OpenSession: TypeAlias = Callable[[RobotSettings, RobotLimits, threading.Event], RobotSession]
