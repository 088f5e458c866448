"""Where the live page is served, and the host names it answers to."""

import errno
import io
import re
import socket
from ipaddress import IPv4Address, IPv6Address, ip_address

import msgspec

from touchd.daemon.app.config import ConfigError, LiveSettings
from touchd.drivers.errors import TouchdError
from touchd.drivers.hosts import own_addresses

# Send buffer of a connection: a second or two of frames.
SEND_BUFFER_BYTES = 16 * 1024
EVERY_ADDRESS = ("0.0.0.0", "::")


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
    if not is_host or not (port.isascii() and port.isdigit()) or int(port) not in range(65536):
        raise ConfigError(f"--live {text}: not [HOST:]PORT, such as 8054, 0.0.0.0:8054 or [::1]:8054")
    host = host.removeprefix("[").removesuffix("]") or settings.host
    return msgspec.structs.replace(settings, host=host, port=int(port))


def listen(settings: LiveSettings) -> socket.socket:
    """Return a socket that listens at the configured address; raises LiveError.

    If the host is the name of another computer, it listens at every address: others may know this computer by
    that name, as with a container.
    """
    host, port = settings.host, settings.port
    try:
        found = socket.getaddrinfo(host.encode(), port, type=socket.SOCK_STREAM)
        # A name may have only an IPv6 address, as localhost on some computers.
        family, *_, address = min(found, key=lambda entry: entry[0] != socket.AF_INET)
        takes_both = host == "::" and socket.has_dualstack_ipv6()
        listening = socket.create_server(address[:2], family=family, dualstack_ipv6=takes_both)
    except OSError as error:
        if error.errno != errno.EADDRNOTAVAIL or ip_of(host):
            raise _cannot_listen(host, port, error) from error
        return listen(msgspec.structs.replace(settings, host="0.0.0.0"))
    # Every connection inherits it.
    listening.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, SEND_BUFFER_BYTES)
    return listening


def _cannot_listen(host: str, port: int, error: OSError) -> LiveError:
    another = _at(host, 8061 if port != 8061 else 8062)
    known = {
        errno.EADDRINUSE: f"another program does, perhaps another touchd; choose another: --live {another}",
        errno.EACCES: "ports below 1024 are the system's; choose a higher one",
        errno.EADDRNOTAVAIL: "this computer has no such address; 127.0.0.1 is this computer alone, "
        "0.0.0.0 the network too",
        socket.EAI_NONAME: "no such name is known; check it, or give it an address in /etc/hosts",
    }
    why = known.get(error.errno or 0, f"{error.strerror}; choose another address")
    return LiveError(f"the live page cannot listen on {host} port {port}: {why}")


def _at(host: str, port: int) -> str:
    return f"[{host}]:{port}" if ":" in host else f"{host}:{port}"


def urls_of(settings: LiveSettings, port: int) -> list[str]:
    """Return the page's addresses, the likeliest first; for 0.0.0.0 one for each IP address.

    They are numeric, since a phone may not resolve this computer's name.
    """
    hosts = [settings.host]
    if settings.host in EVERY_ADDRESS:
        hosts = own_addresses() or [socket.gethostname()]
    return [f"http://{_at(host, port)}/" for host in hosts]


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
    """Whether a Host header names this computer by one of `names` or by an IP address.

    Another site can point its own name at us (DNS rebinding), but then the Host header contains that name,
    never an IP address. Any port is accepted, since it differs at the other end of a tunnel.
    """
    name = name_in(host)
    return name in names or ip_of(name) is not None


def name_in(host: str) -> str:
    """Return the name or IP address in a Host header, NAME[:PORT], in lower case; "" if it has none."""
    match = re.fullmatch(r"(\[[^\]]*\]|[^:]*)(:\d{1,5})?", host)
    return match[1].strip("[]").lower() if match else ""


def ip_of(name: str) -> IPv4Address | IPv6Address | None:
    """Return the IP address that a text is, None for a name."""
    try:
        return ip_address(name)
    except ValueError:
        return None
