"""How a robot is reached: its address and login, time limits, and what a session can do."""

import re
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal, Protocol, TypeAlias

import msgspec

from touchd.drivers.errors import TouchdError
from touchd.drivers.whole_file import secret_in

# On which NAOqi listens: up to 2.8, and 2.9.
PORTS = {"tcp": 9559, "tcps": 9503}
ADDRESS = re.compile(r"(?:(tcps?)://)?(\[[^\s\[\]]+\]|[^\s/@:\[\]]+)(?::(\d{0,5}))?", re.IGNORECASE)
# Limit for a call once the daemon stops; three of them fit into the two seconds it has for that.
STOPPING_LIMIT_S = 0.25
ADVICE = "if a robot is there, check user and token, and whether it wants tcp:// or tcps://"


class RobotError(TouchdError):
    """The robot cannot be used as configured: the user must change something. The message is one line."""


class RobotLost(Exception):  # noqa: N818 - says what happened; it is handled, never shown as an error
    """The robot is gone or answers too late (a call may still run there); only a new session helps."""


class RobotRefused(Exception):  # noqa: N818 - as above
    """The robot answered with an error, or has no such service or method; the session goes on."""


@dataclass(frozen=True, kw_only=True)
class RobotLimits:
    """Every wait and every buffer of the link to the robot, in seconds unless named otherwise.

    connect_s: for a connection, or for finding a service. call_s: for any call on the event path.
    action_s: for one action, which answers only when it is over; a dance takes minutes.
    stale_s: what has waited longer than this is dropped, since a late answer is worse than none.
    heartbeat_s: how often an idle robot is asked something, as a hung one still looks connected.
    capacity: messages, or reactions, that wait at most; the oldest is dropped.
    """

    connect_s: float = 3.0
    call_s: float = 1.0
    action_s: float = 600.0
    stale_s: float = 2.0
    heartbeat_s: float = 0.3
    capacity: int = 64


class Wait:
    """A wait with a limit, which is shorter once the daemon stops. what: what is waited for, in errors."""

    def __init__(self, what: str, limit_s: float, stopping: threading.Event) -> None:
        self.what = what
        self._limit_s = limit_s
        self._stopping = stopping
        self._begun_s = time.monotonic()

    def go_on(self) -> None:
        """Raise RobotLost when it is over."""
        waited_s = time.monotonic() - self._begun_s
        if waited_s >= self._limit_s or (self._stopping.is_set() and waited_s >= STOPPING_LIMIT_S):
            raise RobotLost(f"{self.what}: no answer within {waited_s:.1f} s")


def address_of(url: str) -> tuple[str, str, int]:
    """Return a robot's scheme (tcp if none is named), host and port; a ValueError shows no password."""
    parts = ADDRESS.fullmatch(url.strip())
    if parts is None or int(parts[3] or 1) not in range(1, 65536):
        raise ValueError(f"url {without_password(url)!r} is not an address such as tcp://nao.local:9559")
    scheme = (parts[1] or "tcp").lower()
    return scheme, parts[2].strip("[]"), int(parts[3] or PORTS[scheme])


def without_password(address: str) -> str:
    """Return an address that may be shown: what is before an @ may be a password."""
    return re.sub(r"//.*@", "//***@", address)


class RobotSettings(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Where the robot is and how to log in. The token itself is never among the settings.

    certificate: the fingerprint of the robot's, sha256:HEX, or "any"; a token needs it. client: "qi" uses the
    robot's own library instead of `wire`.
    """

    url: str
    prefix: str = "TouchGesture"
    user: str | None = None
    token_file: str | None = None
    certificate: str | None = None
    client: Literal["touchd", "qi"] = "touchd"

    def __post_init__(self) -> None:
        if not re.fullmatch(r"\w+", self.prefix) or self.prefix.startswith("AL"):
            raise ValueError(f"prefix {self.prefix!r} must be one word and not begin with AL, as the robot's")
        if (self.user is None) != (self.token_file is None):
            raise ValueError("a login is user and token_file; set both (user: nao on most robots)")
        if self.token_file is not None and "/" not in self.token_file:
            raise ValueError("token_file is not a full path; write the token into a file and give its path")
        scheme, _, _ = self.address
        if scheme != "tcps" and (self.user or self.certificate):
            raise ValueError(f"url {self.url}: what is sent there is not encrypted; use tcps://")
        if self.client == "qi" and self.pinned:
            raise ValueError("qi accepts any certificate; leave client out, or certificate")

    @property
    def pinned(self) -> str | None:
        """The fingerprint that the robot must show, None for any."""
        return None if self.certificate == "any" else self.certificate

    @property
    def address(self) -> tuple[str, str, int]:
        return address_of(self.url)

    def read_token(self) -> str:
        """Return the token; raises RobotError if it cannot be read, or if anybody might get it."""
        token = secret_in(str(self.token_file), "robot.token_file", RobotError)
        if not self.certificate:
            raise RobotError(
                f"robot {self.url}: whoever answers there would get the token; set robot.certificate to the "
                "robot's, which touchd doctor shows, or to any if nobody else can answer"
            )
        return token


class RobotSession(Protocol):
    """One connection to a robot. One thread uses it; after RobotLost it is only closed."""

    def connect(self) -> None:
        """Connect and log in; raises RobotLost."""

    def connected(self) -> bool:
        """Return False as soon as the connection is known to be gone; a hung robot still reads True."""

    def call(self, service: str, method: str, *arguments: object, limit_s: float) -> object:
        """Call a service with builtin types and return its answer; raises RobotLost or RobotRefused."""

    def close(self) -> None:
        """Drop the connection at once; idempotent."""


# The event is set when the daemon stops; then no call may take longer than STOPPING_LIMIT_S.
OpenSession: TypeAlias = Callable[[RobotSettings, RobotLimits, threading.Event], RobotSession]
