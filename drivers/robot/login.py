"""The login for a robot that asks for one (NAOqi 2.9), and what is wrong with an address.

Reads the token, and checks who else could get it.
"""

import ipaddress
import logging
import os
import re
import stat
from contextlib import suppress
from dataclasses import dataclass, field

from touchd.drivers.errors import written_out
from touchd.drivers.robot.session import RobotError, RobotSettings

log = logging.getLogger(__name__)

MAX_TOKEN_BYTES = 4096
# On which NAOqi listens: up to 2.8, and 2.9.
PORTS = {"tcp": 9559, "tcps": 9503}


@dataclass
class Login:
    """The login for a robot that asks for one (NAOqi 2.9). Its repr does not show the token.

    libqi calls both methods by these names; it refuses a frozen object.
    """

    user: str
    token: str = field(repr=False)

    def newAuthenticator(self) -> "Login":  # noqa: N802
        return self

    def initialAuthData(self) -> dict[str, str]:  # noqa: N802
        return {"user": self.user, "token": self.token}


def without_password(address: str) -> str:
    """Return an address that may be shown: what is before an @ may be a password."""
    return re.sub(r"//.*@", "//***@", address)


def wrong_address(url: str) -> RobotError:
    """Return an error that says what is wrong with a robot's address."""
    shown = without_password(url)
    if host := re.fullmatch(r"(tcps?)://([^\s/@:]+):?", url):
        port = PORTS[host[1]]
        return RobotError(f"robot url {shown!r} lacks its port, usually {port}: {host[1]}://{host[2]}:{port}")
    return RobotError(f"robot url {shown!r} is not an address such as tcp://nao.local:9559")


def login_of(settings: RobotSettings, user: str, host: str) -> Login:
    """Return the login of a user at a robot's host; raises RobotError with one line."""
    if not settings.url.startswith("tcps://"):
        raise RobotError(
            f"robot {settings.url} would get the token unencrypted; use tcps://, or leave user out"
        )
    if settings.token_file is None:
        raise RobotError("robot has a user but no token; set token_file")
    login = Login(user, _read_token(settings.token_file))
    _warn_of_readers(settings.token_file)
    if _is_here(host):
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


def _read_token(token_file: str) -> str:
    where = _shown(token_file)
    try:
        # A pipe that nobody writes to must not hold the daemon up.
        fd = os.open(written_out(token_file), os.O_RDONLY | os.O_NONBLOCK)
        with open(fd, "rb", buffering=0) as file:
            content = file.read(MAX_TOKEN_BYTES + 1) or b""
        token = content.decode("utf-8-sig").strip()
    except (OSError, UnicodeDecodeError) as error:
        why = error.strerror if isinstance(error, OSError) else "not text"
        raise RobotError(f"robot token_file {where} cannot be read ({why})") from error
    if len(content) > MAX_TOKEN_BYTES:
        raise RobotError(f"robot token_file {where} is larger than {MAX_TOKEN_BYTES} bytes, so not a token")
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
    # A value that is not a path may be the token.
    return token_file if "/" in token_file else "(not shown, since it is not a full path)"
