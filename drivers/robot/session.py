"""How a robot is reached: its address and login, time limits, and what a session can do."""

import ipaddress
import re
import socket
import threading
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from typing import Literal, NamedTuple, Protocol, TypeAlias

import msgspec

from touchd.drivers.errors import TouchdError

# On which NAOqi listens: up to 2.8, and 2.9.
PORTS = {"tcp": 9559, "tcps": 9503}
# Limit for a call once the daemon stops; three of them fit into the two seconds it has for that.
STOPPING_LIMIT_S = 0.25
ADVICE = "if a robot is there, check user and token, and whether it wants tcp:// or tcps://"


class RobotError(TouchdError):
    """The robot cannot be used as configured: the user must change something. The message is one line."""


@dataclass(frozen=True, kw_only=True)
class RobotLimits:
    """Every wait and every buffer of the link to the robot, in seconds unless named otherwise.

    connect_s: for a connection, or for finding a service (measured on loopback: 12 ms and 1 ms).
    call_s: for any call on the event path (0.3 ms; a robot on a bad network needs a hundred times that).
    action_s: for one action; speech and behaviours answer only when they are over, a dance after minutes.
    stale_s: what has waited longer than this is dropped, since a late answer is worse than none.
    heartbeat_s: the robot is asked something after this much silence. With call_s it bounds how long a hang
    goes unnoticed, because a hung robot still looks connected.
    backoff_first_s, backoff_cap_s: pause before another attempt, doubling from the one to the other. The cap
    bounds how long a robot that is back goes unnoticed.
    capacity: messages, or reactions, that wait at most; the oldest is dropped.
    """

    connect_s: float = 3.0
    call_s: float = 1.0
    action_s: float = 600.0
    stale_s: float = 2.0
    heartbeat_s: float = 0.3
    backoff_first_s: float = 0.1
    backoff_cap_s: float = 1.0
    capacity: int = 64


class Address(NamedTuple):
    """scheme: tcp or tcps."""

    scheme: str
    host: str
    port: int

    @property
    def url(self) -> str:
        host = f"[{self.host}]" if ":" in self.host else self.host
        return f"{self.scheme}://{host}:{self.port}"

    @property
    def family(self) -> socket.AddressFamily | None:
        """None if the host is a name."""
        with suppress(ValueError):
            is_6 = ipaddress.ip_address(self.host).version == 6
            return socket.AF_INET6 if is_6 else socket.AF_INET
        return None

    @property
    def is_here(self) -> bool:
        """Whether it is this computer."""
        return (
            self.host == "localhost" if self.family is None else ipaddress.ip_address(self.host).is_loopback
        )


def address_of(url: str) -> Address:
    """Return the parts of a robot's URL; raises ValueError with what is wrong, without a password."""
    parts = re.fullmatch(
        r"(tcps?)://(\[[^\s\[\]]+\]|[^\s/@:\[\]]+)(?::(\d{0,5}))?", url.strip(), re.IGNORECASE
    )
    shown = without_password(url)
    if parts is None or int(parts[3] or 1) not in range(1, 65536):
        raise ValueError(f"url {shown!r} is not an address such as tcp://nao.local:9559")
    scheme = parts[1].lower()
    if not parts[3]:
        port = PORTS[scheme]
        raise ValueError(f"url {shown!r} lacks its port, usually {port}: {scheme}://{parts[2]}:{port}")
    return Address(scheme, parts[2].strip("[]"), int(parts[3]))


def without_password(address: str) -> str:
    """Return an address that may be shown: what is before an @ may be a password."""
    return re.sub(r"//.*@", "//***@", address)


class RobotSettings(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Where the robot is and how to log in. The token itself is never among the settings.

    certificate: a file with the robot's certificate, or its fingerprint, sha256:HEX. trust_network: send the
    token to whoever answers. Beyond this computer, a token needs one of the two.
    client: "qi" uses the robot's own library instead of `wire`.
    """

    url: str
    prefix: str = "TouchGesture"
    user: str | None = None
    token_file: str | None = None
    certificate: str | None = None
    trust_network: bool = False
    client: Literal["touchd", "qi"] = "touchd"

    def __post_init__(self) -> None:
        if not re.fullmatch(r"\w+", self.prefix) or self.prefix.startswith("AL"):
            raise ValueError(
                f"prefix {self.prefix!r} must be one word that does not begin with AL (the robot's)"
            )
        address = address_of(self.url)
        if self.user is None and self.token_file:
            raise ValueError("there is a token_file but no user; set user (nao on most robots)")
        if self.user is not None and self.token_file is None:
            raise ValueError("there is a user but no token; set token_file")
        if address.scheme != "tcps" and (self.user or self.certificate):
            raise ValueError(f"url {self.url}: what is sent there is not encrypted; use tcps://")
        if self.client == "qi" and self.certificate:
            raise ValueError("qi accepts any certificate; leave client out, or certificate")

    @property
    def address(self) -> Address:
        return address_of(self.url)


class RobotLost(Exception):  # noqa: N818 - says what happened; it is handled, never shown as an error
    """The robot is gone or answers too late (a call may still run there); only a new session helps."""


class RobotRefused(Exception):  # noqa: N818 - as above
    """The robot answered with an error, or has no such service or method; the session goes on."""


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
