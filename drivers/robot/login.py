"""What robot and touchd prove to each other: the robot its certificate, touchd the token of NAOqi 2.9."""

import hashlib
import logging
import os
import re
import socket
import ssl
import stat
from collections.abc import Callable
from dataclasses import dataclass, field

from touchd.drivers.errors import PathError, written_out
from touchd.drivers.robot.session import RobotError, RobotLost, RobotSettings

log = logging.getLogger(__name__)

MAX_TOKEN_BYTES = 4096
FINGERPRINT = re.compile(r"sha256:([0-9a-f]{2}:?){31}[0-9a-f]{2}", re.IGNORECASE)


@dataclass(frozen=True)
class Login:
    """The login for a robot that asks for one (NAOqi 2.9). Its repr does not show the token."""

    user: str
    token: str = field(repr=False)


def check_login(settings: RobotSettings) -> None:
    """Read token and certificate, and warn of who else may get the token; raises RobotError with one line."""
    if settings.certificate is not None:
        _context(settings.certificate)
    if read_login(settings) is None:
        return
    if not (settings.address.is_here or settings.certificate or settings.trust_network):
        raise RobotError(
            f"robot {settings.url}: whoever answers there would get the token; set robot.certificate to the "
            "robot's, which touchd doctor shows, or robot.trust_network: true if nobody else can answer"
        )
    token_file = str(settings.token_file)
    mode = written_out(token_file).stat().st_mode
    if stat.S_ISREG(mode) and mode & (stat.S_IRWXG | stat.S_IRWXO) & ~stat.S_IRGRP:
        log.warning(
            "robot token_file %s can be read or changed by others: chmod 640 it (the service also needs: "
            "chgrp touchd)",
            _shown(token_file),
        )
    if settings.certificate is None and not settings.address.is_here:
        log.warning(
            "robot %s: the token is sent to whoever answers there (robot.trust_network)", settings.url
        )


def read_login(settings: RobotSettings) -> Login | None:
    """Return the login, None if no user is set; raises RobotError with one line."""
    if settings.user is None:
        return None
    token_file = str(settings.token_file)
    where = _shown(token_file)
    try:
        # A pipe that nobody writes to must not hold the daemon up.
        fd = os.open(written_out(token_file), os.O_RDONLY | os.O_NONBLOCK)
        with open(fd, "rb", buffering=0) as file:
            content = file.read(MAX_TOKEN_BYTES + 1) or b""
        token = content.decode("utf-8-sig").strip()
    except (OSError, UnicodeDecodeError) as error:
        why = error.strerror if isinstance(error, OSError) else "not text"
        raise RobotError(f"robot.token_file {where} cannot be read ({why})") from error
    if len(content) > MAX_TOKEN_BYTES:
        raise RobotError(f"robot.token_file {where} is larger than {MAX_TOKEN_BYTES} bytes, so not a token")
    if not token:
        raise RobotError(f"robot.token_file {where} is empty or missing; put the token there")
    return Login(settings.user, token)


def _shown(token_file: str) -> str:
    # A value that is not a path may be the token.
    return token_file if "/" in token_file else "(not shown, since it is not a full path)"


def encrypted(line: socket.socket, certificate: str | None, go_on: Callable[[], None]) -> ssl.SSLSocket:
    """Begin TLS on a connection and check the robot's certificate; raises RobotLost, RobotError or OSError.

    go_on: called whenever the connection's timeout is over, to raise an error or to continue.
    """
    tls = _context(certificate).wrap_socket(line, do_handshake_on_connect=False)
    while True:
        try:
            tls.do_handshake()
            break
        except TimeoutError:
            go_on()
        except ssl.SSLCertVerificationError as error:
            raise RobotLost(
                f"connecting: not the robot of robot.certificate: {error.verify_message}"
            ) from error
    pinned = certificate or ""
    shown = fingerprint(tls)
    if FINGERPRINT.fullmatch(pinned) and shown != f"sha256:{pinned[7:].replace(':', '').lower()}":
        raise RobotLost(f"connecting: not the robot of robot.certificate: this one's is {shown}")
    return tls


def fingerprint(tls: ssl.SSLSocket) -> str:
    """Return the fingerprint of the other end's certificate, as in robot.certificate."""
    return f"sha256:{hashlib.sha256(tls.getpeercert(binary_form=True) or b'').hexdigest()}"


def _context(certificate: str | None) -> ssl.SSLContext:
    """Return what begins TLS, and checks the robot's certificate against a file; raises RobotError."""
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
    # A robot signs its certificate itself, and moves from network to network.
    context.check_hostname = False
    if certificate is None or FINGERPRINT.fullmatch(certificate):
        context.verify_mode = ssl.CERT_NONE
        return context
    context.verify_flags |= ssl.VERIFY_X509_PARTIAL_CHAIN
    try:
        context.load_verify_locations(written_out(certificate))
    except (OSError, PathError) as error:
        why = error.strerror if isinstance(error, OSError) and error.strerror else error
        raise RobotError(
            f"robot.certificate {certificate}: neither sha256: and 64 digits, nor a file with a certificate "
            f"in PEM ({why})"
        ) from error
    return context
