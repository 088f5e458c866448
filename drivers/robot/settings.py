"""Where the robot is, how to log in, and how long it may take."""

import ipaddress
import logging
import os
import re
import stat
from contextlib import suppress
from dataclasses import dataclass, field
from typing import Annotated

import msgspec

from touchd.drivers.errors import TouchdError, written_out

log = logging.getLogger(__name__)

MAX_TOKEN_BYTES = 4096


class RobotError(TouchdError):
    """The robot cannot be used as configured: the user must change something. The message is one line."""


@dataclass(frozen=True)
class Login:
    """The login for a robot that asks for one (NAOqi 2.9). Its repr does not show the token."""

    user: str
    token: str = field(repr=False)


@dataclass(frozen=True, kw_only=True)
class RobotLimits:
    """Every wait and every buffer of the link to the robot, in seconds unless named otherwise.

    connect_s, service_s, call_s: for a connection, for the proxy of a service, for any call on the event path
    (measured: 12 ms, 1 ms and 0.3 ms on loopback; a robot on a bad network needs a hundred times that).
    action_s: for one action; speech and behaviours answer only when they are over, a dance after a minute.
    stale_s: what has waited longer than this is dropped, since a late answer is worse than none.
    heartbeat_s: the robot is asked something after this much silence. With call_s it bounds how long a hang
    goes unnoticed, because a hung robot still looks connected.
    shown_s: how long PREFIX/Gesture stays in the robot's memory, as its own ALTactileGesture does it.
    backoff_first_s, backoff_cap_s: pause before another attempt, doubling from the one to the other. The cap
    bounds how long a robot that is back goes unnoticed.
    capacity: messages, or reactions, that wait at most; the oldest is dropped.
    """

    connect_s: float = 3.0
    service_s: float = 3.0
    call_s: float = 1.0
    action_s: float = 120.0
    stale_s: float = 2.0
    heartbeat_s: float = 0.3
    shown_s: float = 1.0
    backoff_first_s: float = 0.1
    backoff_cap_s: float = 1.0
    capacity: int = 64


class RobotSettings(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Where the robot is and how to log in. The token itself is never among the settings.

    url: tcp://host:9559 for NAOqi up to 2.8, tcps://host:9503 for 2.9. libqi encrypts the latter, but checks
    no certificate. prefix: of the ALMemory events raised.
    user, and token_file or token_env (a file, or an environment variable, that holds the token): for NAOqi
    2.9, which asks.
    trust_network: libqi takes any certificate for the robot's, so whoever can step in between gets the token;
    it is sent beyond this computer only where this says that nobody can.
    call_s: how long the robot may take for a call before it counts as gone. action_s: the same for an action,
    which is over when the speech or behaviour is.
    """

    url: str
    prefix: str = "TouchGesture"
    user: str | None = None
    token_file: str | None = None
    token_env: str | None = None
    trust_network: bool = False
    call_s: Annotated[float, msgspec.Meta(ge=0.1, le=10)] = 1.0
    action_s: Annotated[float, msgspec.Meta(ge=1, le=3600)] = 120.0

    def __post_init__(self) -> None:
        if not re.fullmatch(r"\w+", self.prefix) or self.prefix.startswith("AL"):
            raise ValueError(
                f"prefix {self.prefix!r} must be one word that does not begin with AL (the robot's)"
            )
        if self.token_file is not None and self.token_env is not None:
            raise ValueError("token_file and token_env are both set; keep one")


def read_login(settings: RobotSettings) -> Login | None:
    """Return whom to log in as, None where no user is set; raises RobotError with one line.

    The token comes from a file or an environment variable, and is in no text made of the result.
    """
    address = re.fullmatch(r"tcps?://([^\s/@:]+):(\d{1,5})", settings.url)
    if address is None or int(address[2]) > 65535:
        # Do not show a password in it.
        shown = re.sub(r"//.*@", "//***@", settings.url)
        raise RobotError(f"robot url {shown!r} is not an address such as tcp://nao.local:9559")
    if settings.user is None:
        if settings.token_file or settings.token_env:
            raise RobotError("robot has a token but no user; set user (nao on most robots)")
        return None
    if not settings.url.startswith("tcps://"):
        raise RobotError(
            f"robot {settings.url} would get the token unencrypted; use tcps://, or leave user out"
        )
    login = Login(settings.user, read_token(settings))
    if settings.token_file is not None:
        _warn_of_readers(settings.token_file)
    if _is_here(address[1]):
        return login
    if not settings.trust_network:
        raise RobotError(
            f"robot {settings.url}: its certificate cannot be checked, so whoever is between could read the "
            "token; set robot.trust_network: true if nobody can be, or leave user out"
        )
    log.warning("robot %s: the token is sent to whoever answers there (robot.trust_network)", settings.url)
    return login


def _is_here(host: str) -> bool:
    with suppress(ValueError):
        return ipaddress.ip_address(host).is_loopback
    return host == "localhost"


def read_token(settings: RobotSettings) -> str:
    """Return the token as it is now; raises RobotError with one line, which does not show it."""
    if settings.token_file is not None:
        where = _shown(settings.token_file)
        try:
            # A pipe that nobody writes to must not hold the daemon up.
            fd = os.open(written_out(settings.token_file), os.O_RDONLY | os.O_NONBLOCK)
            with open(fd, "rb", buffering=0) as file:
                content = file.read(MAX_TOKEN_BYTES + 1) or b""
            token = content.decode().strip()
        except (OSError, UnicodeDecodeError) as error:
            why = error.strerror if isinstance(error, OSError) else "not text"
            raise RobotError(f"robot token_file {where} cannot be read ({why})") from error
        if len(content) > MAX_TOKEN_BYTES:
            raise RobotError(
                f"robot token_file {where} is larger than {MAX_TOKEN_BYTES} bytes, so not a token"
            )
    elif settings.token_env is not None:
        where = settings.token_env
        token = os.environ.get(where, "").strip()
    else:
        raise RobotError("robot has a user but no token; set token_file or token_env")
    if not token:
        raise RobotError(f"the robot's token in {where} is empty or missing; put it there")
    return token


def _warn_of_readers(token_file: str) -> None:
    mode = written_out(token_file).stat().st_mode
    if stat.S_ISREG(mode) and mode & (stat.S_IRWXG | stat.S_IRWXO) & ~stat.S_IRGRP:
        log.warning(
            "robot token_file %s can be read or changed by others: chmod 640 it (the service also needs: "
            "chgrp touchd)",
            _shown(token_file),
        )


def _shown(token_file: str) -> str:
    # A value that is no path may be the token itself.
    return token_file if "/" in token_file else "(not shown, since it is no full path)"
