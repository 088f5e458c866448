"""A stand-in for systemd's notification socket."""

import socket
from pathlib import Path

from rigs.wait import WITHIN_S


class Manager:
    """A socket that receives a service's notifications."""

    def __init__(self, folder: Path) -> None:
        path = folder / "notify"
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
        self._socket.bind(str(path))
        self._socket.settimeout(WITHIN_S)
        self.environ = {"NOTIFY_SOCKET": str(path), "WATCHDOG_USEC": "3600000000"}

    def hear(self) -> str:
        return self._socket.recv(4096).decode()

    def received(self) -> list[str]:
        """Return everything received so far."""
        self._socket.setblocking(False)
        messages = []
        while True:
            try:
                messages.append(self.hear())
            except BlockingIOError:
                return messages

    def await_ready(self) -> None:
        while self.hear() != "READY=1":
            pass

    def close(self) -> None:
        self._socket.close()
