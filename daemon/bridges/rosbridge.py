"""rosbridge: ROS 1, and ROS 2 behind a firewall or on another processor, by JSON over a websocket."""

import base64
import logging
import socket
import threading
from collections.abc import Mapping, Sequence
from typing import Any

import msgspec
from websockets.exceptions import WebSocketException
from websockets.sync.client import ClientConnection, connect

from touchd.daemon.bridges.bridge import Bridge
from touchd.daemon.bridges.settings import RosbridgeSettings
from touchd.daemon.events import Event, Prediction, encode
from touchd.drivers.frame import COLUMNS, ROWS, Frame

CONNECTION: Mapping[str, Any] = {
    "open_timeout": 1.0,
    "close_timeout": 0.2,
    "ping_interval": 5.0,
    "ping_timeout": 5.0,
    # Replies are short, and without a subscription there are none.
    "max_size": 64 * 1024,
    "compression": None,
    "proxy": None,
}
# websockets cannot ping, nor see that no answer comes, while it waits for what it sends to be taken.
UNTAKEN_MS = 10_000
# In the form that servers of ROS 1 and ROS 2 accept.
STRING, IMAGE = "std_msgs/String", "sensor_msgs/Image"


class RosbridgeBridge(Bridge):
    """Publishes the topics of `Ros2Bridge`; a thread of its own keeps the connection and reconnects."""

    def __init__(self, settings: RosbridgeSettings, pad: str, labels: Sequence[str] = ()) -> None:
        self._settings = settings
        self._prefix = f"{settings.namespace}/{pad}"
        self._connection: ClientConnection | None = None
        self._ending = threading.Event()
        self._keeper = threading.Thread(
            target=self._keep_connected, name="touchd-rosbridge-link", daemon=True
        )
        super().__init__("rosbridge", pad, settings.pressure_hz)

    def open(self) -> None:
        # The keeper thread logs failed attempts itself, once.
        logging.getLogger("websockets.client").setLevel(logging.CRITICAL)
        self._keeper.start()

    def write(self, item: Event | Frame) -> None:
        """Send one message, or two; an event is sent again over the next connection if this one is lost."""
        if isinstance(item, Frame):
            self._send([self._publish("pressure", self._image(item))])
            return
        messages = [self._publish("event", {"data": encode(item).decode()})]
        if isinstance(item, Prediction) and item.told:
            messages.insert(0, self._publish("gesture", {"data": item.gesture}))
        while self._await_peer() and not self._send(messages):
            pass

    def close(self) -> None:
        self._ending.set()
        if (connection := self._connection) is not None:
            connection.close()
        self._keeper.join()

    def _keep_connected(self) -> None:
        url = self._settings.url
        while not self._ending.is_set():
            try:
                with connect(url, **CONNECTION) as connection:
                    connection.socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_USER_TIMEOUT, UNTAKEN_MS)
                    self._connection = connection
                    for name, kind in (("gesture", STRING), ("event", STRING), ("pressure", IMAGE)):
                        advertised = {"op": "advertise", "topic": f"{self._prefix}/{name}", "type": kind}
                        connection.send(msgspec.json.encode(advertised).decode())
                    self._tell_there(url)
                    for _ in connection:
                        pass
                self._tell_away(url, "the connection was closed")
            # A URL that cannot be one is a ValueError.
            except (OSError, WebSocketException, ValueError) as error:
                self._tell_away(url, str(error))
            self._ending.wait(self._backoff.pause_s())

    def _send(self, messages: Sequence[str]) -> bool:
        connection = self._connection
        if connection is None:
            return False
        try:
            for message in messages:
                connection.send(message)
        except (OSError, WebSocketException):
            # The other thread then notices, and connects again.
            connection.close()
            return False
        return True

    def _publish(self, name: str, message: dict[str, Any]) -> str:
        operation = {"op": "publish", "topic": f"{self._prefix}/{name}", "msg": message}
        return msgspec.json.encode(operation).decode()

    def _image(self, frame: Frame) -> dict[str, Any]:
        # The server fills in the header's time.
        return {
            "header": {"frame_id": self.pad},
            "height": ROWS,
            "width": COLUMNS,
            "encoding": "mono16",
            "is_bigendian": 0,
            "step": 2 * COLUMNS,
            "data": base64.b64encode(frame.pressure.astype("<u2").tobytes()).decode(),
        }
