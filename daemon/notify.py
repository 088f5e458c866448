"""systemd's notifications (sd_notify): datagrams to the socket that it names in the environment."""

from __future__ import annotations

import os
import socket
from collections.abc import Mapping


class Notifier:
    """Tells systemd that the service is ready, alive and how it fares; silent when nobody asked.

    environ: NOTIFY_SOCKET, WATCHDOG_USEC and WATCHDOG_PID as systemd sets them (sd_notify(3),
    sd_watchdog_enabled(3)).
    """

    def __init__(self, environ: Mapping[str, str]) -> None:
        address = environ.get("NOTIFY_SOCKET", "")
        # A name that begins with @ stands for Linux's abstract namespace.
        self._address = f"\0{address[1:]}" if address.startswith("@") else address
        self._socket: socket.socket | None = None
        if address:
            self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM | socket.SOCK_CLOEXEC)
            self._socket.setblocking(False)
        watched = environ.get("WATCHDOG_PID", str(os.getpid())) == str(os.getpid())
        self.watchdog_s = int(environ.get("WATCHDOG_USEC", "0")) / 1e6 if watched else 0.0

    @property
    def wanted(self) -> bool:
        """Whether anybody listens."""
        return self._socket is not None

    def send(self, **fields: str | int) -> None:
        """Send fields such as READY=1; a manager that does not take them is left alone."""
        if self._socket is not None:
            message = "\n".join(f"{name}={value}" for name, value in fields.items())
            try:
                self._socket.sendto(message.encode(), self._address)
            except OSError:
                return

    def close(self) -> None:
        """Close the socket."""
        if self._socket is not None:
            self._socket.close()
            self._socket = None
