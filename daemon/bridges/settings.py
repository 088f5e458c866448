"""The sections of the configuration for bridges to other systems; touchd.example.yaml explains them."""

from typing import Annotated
from urllib.parse import urlsplit

import msgspec

PressureHz = Annotated[float, msgspec.Meta(ge=0.001, le=500)]
Port = Annotated[int, msgspec.Meta(ge=1, le=65535)]
# The name of a robot as MQTT, LSL and ROS take it.
_PART = "[A-Za-z][A-Za-z0-9]*(_[A-Za-z0-9]+)*"
RobotName = Annotated[str, msgspec.Meta(pattern=f"^{_PART}(/{_PART})*$")]


class MqttSettings(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """An MQTT broker; host: name or address. A pad's topics are NAME/PAD/event, /state and /pressure."""

    host: Annotated[str, msgspec.Meta(pattern=r"^(?![^:]*:[^:]*$)[^\s/[\]]+$")] = "localhost"
    port: Port = 1883
    tls: bool = False
    ca_file: str | None = None
    user: str | None = None
    password_file: str | None = None
    pressure_hz: PressureHz | None = None
    discovery: Annotated[str, msgspec.Meta(pattern=r"^[^/+#\s]+(/[^/+#\s]+)*$")] | None = None

    def __post_init__(self) -> None:
        if self.ca_file is not None and not self.tls:
            raise ValueError("ca_file is set without tls; set tls: true")
        if self.password_file is not None and self.user is None:
            raise ValueError("password_file is set without user; set user")


class LslSettings(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Streams of the Lab Streaming Layer: NAME-PAD-markers and NAME-PAD-pressure."""


class Ros2Settings(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """ROS 2 over DDS. A pad's topics are /NAME/PAD/gesture, event and pressure."""

    domain: Annotated[int, msgspec.Meta(ge=0, le=232)] = 0


class RosbridgeSettings(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """A rosbridge server of ROS 1 or ROS 2; the topics are those of `Ros2Settings`.

    url: may end with ?token=..., which is never logged.
    """

    url: Annotated[str, msgspec.Meta(pattern=r"^wss?://[^\s@]+$")] = "ws://localhost:9090"
    pressure_hz: PressureHz | None = None

    def __post_init__(self) -> None:
        try:
            # Reading the port checks it.
            _ = urlsplit(self.url).port
        except ValueError as error:
            raise ValueError(
                f"url: invalid address {self.shown_url} ({error}); write it like ws://robot:9090"
            ) from error

    @property
    def address(self) -> tuple[str, int]:
        """Host and port."""
        parts = urlsplit(self.url)
        return parts.hostname or "", parts.port or (443 if parts.scheme == "wss" else 80)

    @property
    def shown_url(self) -> str:
        """The URL as it may be logged: without the query, which may hold a token."""
        return self.url.partition("?")[0]


Section = MqttSettings | LslSettings | Ros2Settings | RosbridgeSettings
