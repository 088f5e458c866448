"""Where the live page is served, and the host names it answers to."""

import errno
import io
import ipaddress
import logging
import os
import re
import socket

import msgspec

from touchd.daemon.app.config import ConfigError, LiveSettings
from touchd.daemon.live.own_addresses import own_addresses
from touchd.drivers.errors import TouchdError

log = logging.getLogger(__name__)

# Send buffer of a connection: a second or two of frames.
SEND_BUFFER_BYTES = 16 * 1024
EVERY_ADDRESS = ("0.0.0.0", "::")
HIGHEST_PORT = 65535
# Options that let a socket listen at an address that this computer has not got yet; see ip(7) and ipv6(7).
FREEBIND = {socket.AF_INET: (socket.IPPROTO_IP, 15), socket.AF_INET6: (socket.IPPROTO_IPV6, 78)}


class LiveError(TouchdError):
    """The live page cannot be served; the message is one line that says why and what to do."""


def parse_address(text: str, configured: LiveSettings | None) -> LiveSettings:
    """Return the address for [HOST:]PORT, missing parts as configured; raises ConfigError."""
    settings = configured or LiveSettings()
    if not text:
        return settings
    host, _, port = text.rpartition(":")
    # Without brackets, the end of an IPv6 address would be taken for a port.
    is_host = ":" not in host or (host.startswith("[") and host.endswith("]"))
    if not is_host or not (port.isascii() and port.isdigit()) or int(port) > HIGHEST_PORT:
        raise ConfigError(f"--live {text}: not [HOST:]PORT, such as 8054, 0.0.0.0:8054 or [::1]:8054")
    host = host.removeprefix("[").removesuffix("]") or settings.host
    return msgspec.structs.replace(settings, host=host, port=int(port))


def listen(settings: LiveSettings) -> socket.socket:
    """Return a socket that listens where these settings say; raises LiveError."""
    host = settings.host
    takes_both = host == "::" and socket.has_dualstack_ipv6()
    try:
        found = socket.getaddrinfo(host, settings.port, type=socket.SOCK_STREAM)
        # A name may have an IPv6 address alone, as localhost on some computers.
        family, *_, address = min(found, key=lambda entry: entry[0] != socket.AF_INET)
        try:
            listening = socket.create_server(address[:2], family=family, dualstack_ipv6=takes_both)
        except OSError as error:
            # systemd may start the service before the network gives this computer its address.
            if error.errno != errno.EADDRNOTAVAIL or "NOTIFY_SOCKET" not in os.environ:
                raise
            listening = _listen_early(family, (str(address[0]), settings.port))
            log.warning("live page: this computer does not have the address %s yet; waiting for it", host)
    except OSError as error:
        where = f"the live page cannot listen on {host} port {settings.port}"
        raise LiveError(f"{where}: {_why(error, settings.port)}") from error
    number = listening.getsockname()[0]
    if ipaddress.ip_address(number).is_loopback and host != number and "localhost" not in host:
        advice = "no other computer can see the page; 0.0.0.0 serves it to the network"
        log.warning("live page: %s is %s here, as /etc/hosts may say: %s", host, number, advice)
    # Inherited by every connection.
    listening.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, SEND_BUFFER_BYTES)
    return listening


def _listen_early(family: socket.AddressFamily, address: tuple[str, int]) -> socket.socket:
    listening = socket.socket(family)
    try:
        listening.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        listening.setsockopt(*FREEBIND[family], 1)
        listening.bind(address)
        listening.listen()
    except OSError:
        listening.close()
        raise
    return listening


def _why(error: OSError, port: int) -> str:
    if error.errno == errno.EADDRINUSE:
        return f"another program does, perhaps another touchd; end it, or choose another port than {port}"
    if error.errno == errno.EACCES:
        return "ports below 1024 are the system's; choose a higher one"
    if error.errno == socket.EAI_AGAIN:
        return (
            "no name server answers; wait for the network, or give a number: 0.0.0.0 serves the page to all"
        )
    if error.errno == errno.EADDRNOTAVAIL or isinstance(error, socket.gaierror):
        return "this computer has no such address; 127.0.0.1 is this computer alone, 0.0.0.0 the network too"
    return f"{error.strerror}; choose another address"


def urls_of(settings: LiveSettings, port: int) -> list[str]:
    """Return the page's addresses, the likeliest first; for 0.0.0.0 one for each IP address.

    They are numeric, since a phone may not resolve this computer's name.
    """
    hosts = [settings.host]
    if settings.host in EVERY_ADDRESS:
        hosts = own_addresses() or [socket.gethostname()]
    return [f"http://{f'[{host}]' if ':' in host else host}:{port}/" for host in hosts]


def qr_code(url: str) -> str:
    """Return an address as a QR code in half blocks, for a dark terminal."""
    import segno

    drawn = io.StringIO()
    segno.make(url, error="l", micro=False).terminal(drawn, border=2, compact=True)
    return drawn.getvalue()


def own_names(settings: LiveSettings) -> frozenset[str]:
    """Return the host names, in lower case, that the page answers to."""
    name = socket.gethostname().lower()
    short = name.partition(".")[0]
    return frozenset({"localhost", name, short, f"{short}.local", settings.host.lower()})


def is_own_host(host: str, names: frozenset[str]) -> bool:
    """Whether a Host header, NAME[:PORT], names this computer by one of `names` or by a number.

    Another site can point its own name at us (DNS rebinding), but then the Host header carries that name,
    never a number. Any port is accepted, since it differs at the other end of a tunnel.
    """
    match = re.fullmatch(r"(\[[^\]]*\]|[^:]*)(:\d{1,5})?", host)
    if match is None:
        return False
    name = match[1].strip("[]").lower()
    try:
        ipaddress.ip_address(name)
    except ValueError:
        return name in names
    return True
