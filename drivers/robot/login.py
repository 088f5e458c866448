"""What robot and touchd prove to each other: the robot its certificate, touchd the token of NAOqi 2.9."""

import hashlib
import socket
import ssl
from collections.abc import Callable

from touchd.drivers.robot.session import RobotError, RobotLost, RobotSettings
from touchd.drivers.whole_file import secret_in


def read_token(settings: RobotSettings) -> str:
    """Return the token; raises RobotError with one line if it cannot be read, or if anybody might get it."""
    token = secret_in(str(settings.token_file), "robot.token_file", RobotError)
    if not settings.certificate:
        raise RobotError(
            f"robot {settings.url}: whoever answers there would get the token; set robot.certificate to the "
            "robot's, which touchd doctor shows, or to any if nobody else can answer"
        )
    return token


def encrypted(line: socket.socket, certificate: str | None, go_on: Callable[[], None]) -> ssl.SSLSocket:
    """Begin TLS on a connection and check the robot's certificate; raises RobotLost or OSError.

    go_on: called whenever the connection's timeout is over, to raise an error or to continue.
    """
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
    # A robot signs its certificate itself, so only the fingerprint proves anything.
    context.check_hostname = False
    context.verify_mode = ssl.CERT_NONE
    tls = context.wrap_socket(line, do_handshake_on_connect=False)
    while True:
        try:
            tls.do_handshake()
            break
        except TimeoutError:
            go_on()
    shown = fingerprint(tls)
    # openssl writes capitals, and colons between the bytes.
    if certificate is not None and certificate.replace(":", "").lower() != shown.replace(":", ""):
        raise RobotLost(f"connecting: not the robot of robot.certificate: this one's is {shown}")
    return tls


def fingerprint(tls: ssl.SSLSocket) -> str:
    """Return the fingerprint of the other end's certificate, as in robot.certificate."""
    return f"sha256:{hashlib.sha256(tls.getpeercert(binary_form=True) or b'').hexdigest()}"
