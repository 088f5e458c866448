"""Publishes JSON to a rosbridge server: for ROS 1, or ROS 2 behind a firewall or on another processor."""

import base64
import logging
import socket
from collections.abc import Mapping
from contextlib import suppress
from functools import partial
from typing import Any

import msgspec
from websockets.client import ClientProtocol
from websockets.exceptions import WebSocketException
from websockets.sync.client import ClientConnection, connect

from touchd.daemon.bridges.bridge import IMAGE, POLL_S, Bridge, PeerLimit
from touchd.daemon.bridges.settings import RosbridgeSettings
from touchd.daemon.path.events import Event, Prediction, encode
from touchd.drivers import hosts
from touchd.drivers.frame import Frame

CONNECT_S = 3.0
CONNECTION: Mapping[str, Any] = {
    "open_timeout": 1.0,
    "close_timeout": 0.2,
    "ping_interval": 5.0,
    "ping_timeout": 5.0,
    "compression": None,
    "proxy": None,
}
# The topics and their types, as both ROS 1 and ROS 2 servers accept them.
TOPICS = {"gesture": "std_msgs/String", "event": "std_msgs/String", "pressure": "sensor_msgs/Image"}


class RosbridgeBridge(Bridge):
    """Publishes the topics of `Ros2Outlet`; each pad has a connection of its own. name: of the robot."""

    def __init__(self, settings: RosbridgeSettings, name: str, pad: str) -> None:
        self._settings = settings
        self._id = f"touchd_{name}"
        self._prefix = f"/{name}/{pad}"
        self._connection: ClientConnection | None = None
        where = f"{settings.shown_url} ({self._prefix})"
        # The bridge logs why a connection ended; the library's own lines would show the URL's token.
        logging.getLogger("websockets.client").setLevel(logging.CRITICAL)
        super().__init__("rosbridge", [pad], settings.pressure_hz, where)

    def hold(self) -> str:
        url, limit = self._settings.url, self.limit
        try:
            line = hosts.connect(*self._settings.address, CONNECT_S, self._ending)
            # From the first byte on: a server may send more together with its greeting.
            limited: Any = partial(_limit, limit)
            with connect(url, sock=line, create_connection=limited, **CONNECTION) as connection:
                self._connection = connection
                for name, kind in TOPICS.items():
                    self._send(connection, "advertise", name, id=self._id, type=kind)
                self.connected()
                for message in connection:
                    self._read_status(message)
            reason = "the connection was closed"
        except WebSocketException as error:
            reason = str(error)
        if limit.is_exceeded:
            return "it sends more than answers, and touchd subscribes to nothing; is it a rosbridge?"
        return reason.replace(url, self._settings.shown_url)

    def send_event(self, event: Event) -> bool:
        connection = self._connection
        if connection is None:
            return False
        try:
            if isinstance(event, Prediction) and event.told:
                self._send(connection, "publish", "gesture", msg={"data": event.gesture})
            self._send(connection, "publish", "event", msg={"data": encode(event).decode()})
            # A server confirms no message, but its answer to a ping shows that it has read those before.
            pong = connection.ping()
        except WebSocketException:
            return False
        while not pong.wait(POLL_S):
            if connection.close_code is not None or self._abandoned.is_set():
                return False
        return True

    def send_frame(self, frame: Frame, pad: str) -> None:
        if self._connection is not None:
            pixels = base64.b64encode(frame.pressure.astype("<u2").tobytes()).decode()
            # The server fills in the header's time.
            image = {"header": {"frame_id": pad}, **IMAGE, "data": pixels}
            with suppress(WebSocketException):
                self._send(self._connection, "publish", "pressure", msg=image)

    def hang_up(self) -> None:
        if self._connection is not None:
            self._connection.close()

    def _read_status(self, message: str | bytes) -> None:
        """Log what the server refuses; ignore anything else that it sends."""
        # RecursionError: lists nested too deeply.
        with suppress(msgspec.DecodeError, UnicodeDecodeError, RecursionError):
            status = msgspec.json.decode(message, type=_Status)
            if status.level == "error":
                self.note_refused(str(status.msg))

    def _send(self, connection: ClientConnection, operation: str, name: str, **fields: Any) -> None:
        """Send an operation on a topic; a failure closes the connection and raises WebSocketException."""
        message = {"op": operation, "topic": f"{self._prefix}/{name}", **fields}
        connection.send(msgspec.json.encode(message).decode())


class _Status(msgspec.Struct, tag_field="op", tag="status"):
    """A server's status message about something it was sent. level: "error" if it refused that."""

    level: str = ""
    msg: Any = ""


def _limit(limit: PeerLimit, line: socket.socket, protocol: ClientProtocol, **named: Any) -> ClientConnection:
    """Return a connection that is shut down once the server sends too much, before websockets stores it."""
    receive = protocol.receive_data

    def limited(data: bytes | bytearray) -> None:
        if limit.take(len(data)):
            receive(data)
        else:
            with suppress(OSError):
                line.shutdown(socket.SHUT_RDWR)

    protocol.receive_data = limited  # type: ignore[method-assign]
    return ClientConnection(line, protocol, **named)
