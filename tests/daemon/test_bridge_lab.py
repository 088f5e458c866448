"""LSL, ROS 2 and rosbridge: the times, bytes and names that subscribers receive."""

import base64
import logging
import socket
import threading
import time
from collections.abc import Callable
from contextlib import closing
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest
from rigs import attackers
from rigs.made_events import PREDICTION, touch
from rigs.peers import PAD, LslPeer, Ros2Peer, RosbridgePeer, frame, inlet_of, reader_of
from rigs.scripted_model import Scripted
from rigs.sockets import free_port
from rigs.wait import WITHIN_S, wait_for

from touchd.daemon.app.config import Settings
from touchd.daemon.app.parts import make_bridges
from touchd.daemon.bridges.bridge import BridgeError
from touchd.daemon.bridges.process import ProcessBridge
from touchd.daemon.bridges.settings import LslSettings, RosbridgeSettings
from touchd.daemon.path.events import (
    Label,
    RobotAction,
    RobotEvent,
    SensorEvent,
    TouchBegan,
    TouchEnded,
    timestamp,
)
from touchd.daemon.sinks.touches import decode


def test_only_a_failed_load_of_a_library_is_a_warning(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    says = "import sys; print('api_config.cpp:126   INFO| Loaded default config', file=sys.stderr)"
    fails = 'raise RuntimeError("LSL binary not found.\\nSee the manual.")'
    (tmp_path / "pylsl.py").write_text(f"{says}\n{fails}")
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    caplog.set_level(logging.INFO)
    bridge = ProcessBridge(LslSettings(), "touchd", [PAD])
    bridge.start()
    wait_for(lambda: "is away" in caplog.text)
    bridge.stop(2.0)
    why = "lsl: its own process is away (cannot be used on this machine (LSL binary not found. See"
    assert why in caplog.text
    (said,) = (record for record in caplog.records if "Loaded default config" in record.message)
    assert said.levelno == logging.INFO


def test_a_missing_extra_is_one_line_at_the_start(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("importlib.util.find_spec", lambda _: None)
    with pytest.raises(BridgeError, match=r"lsl: pylsl is not installed: .*pip install .*pylsl"):
        make_bridges(Settings(lsl=LslSettings()), {PAD: Scripted()})


def lsl_streams(peer: LslPeer, name: str) -> tuple[Any, Any]:
    """Return what the bridge's own process publishes with, and an inlet that gets one of its streams."""
    from touchd.daemon.bridges.lsl import LslOutlet

    outlet: Any = LslOutlet(peer.name, PAD)
    inlet = inlet_of(f"{peer.name}-{PAD}-{name}", threading.Event())
    wait_for(lambda: getattr(outlet, f"_{name}").have_consumers())
    return outlet, inlet


def test_lsl_frames_carry_their_arrival_time_within_2_ms(tmp_path: Path) -> None:
    pylsl = pytest.importorskip("pylsl")
    peer = LslPeer(tmp_path)
    outlet, inlet = lsl_streams(peer, "pressure")
    # The true arrival on LSL's clock lies between the first and the last of these.
    arrived: list[tuple[float, float]] = []
    for number in range(27):
        before_s, now_s, after_s = pylsl.local_clock(), time.monotonic(), pylsl.local_clock()
        # Send frames up to a quarter of a second after they arrived.
        late_s = 0.01 * number
        arrived.append((before_s - late_s, after_s - late_s))
        outlet.send_frame(frame(number, now_s - late_s))
        time.sleep(1 / 54)
    pulled = [inlet.pull_sample(timeout=WITHIN_S) for _ in range(27)]
    info = inlet.info()
    assert (info.channel_count(), info.nominal_srate()) == (64, pylsl.IRREGULAR_RATE)
    # Tells the streams of two computers apart.
    assert info.source_id() == f"{socket.gethostname()}-{peer.name}-{PAD}-pressure"
    np.testing.assert_array_equal(pulled[5][0], frame(5).pressure.ravel())
    for (_, stamped_s), (first_s, last_s) in zip(pulled, arrived, strict=True):
        assert first_s - 0.002 < stamped_s < last_s + 0.002


def test_a_frame_that_waited_too_long_is_not_published(tmp_path: Path) -> None:
    pytest.importorskip("pylsl")
    with closing(LslPeer(tmp_path)) as peer:
        bridge = peer.bridge()
        inlet = inlet_of(f"{peer.name}-{PAD}-pressure", threading.Event())
        wait_for(bridge._peer_is_there.is_set)
        for number, ago_s in ((1, 10.0), (2, 0.0)):
            bridge.put_frame(frame(number, time.monotonic() - ago_s), PAD)
        np.testing.assert_array_equal(inlet.pull_sample(timeout=WITHIN_S)[0], frame(2).pressure.ravel())


def test_lsl_markers_carry_the_events_time(tmp_path: Path) -> None:
    pylsl = pytest.importorskip("pylsl")
    outlet, inlet = lsl_streams(LslPeer(tmp_path), "markers")
    ago = timestamp(time.time() - 1.0)
    ago_s = pylsl.local_clock() - 1.0
    tags = {"participant": "P07", "trial": "3"}
    for event, marker in (
        (TouchBegan(touch=1, time=ago, sensor_ms=1), "touch_began"),
        (msgspec.structs.replace(PREDICTION, time=ago), "early/stroke/told"),
        (TouchEnded(touch=1, gesture="pat", frames=60, reason="released", time=ago), "touch_ended/pat"),
        (SensorEvent(state="down", time=ago), "sensor/down"),
        (RobotEvent(state="up", time=ago), "robot/up"),
        (RobotAction(touch=1, action="say", what="Hello", time=ago), "robot_action/say"),
        (Label(touch=1, began=ago, gesture="rub", time=ago, tags=tags), "label/rub/participant=P07/trial=3"),
    ):
        outlet.send_event(event)
        (said,), stamp_s = inlet.pull_sample(timeout=WITHIN_S)
        assert said == marker
        assert stamp_s == pytest.approx(ago_s, abs=0.2)


def test_ros2_nodes_find_and_receive_the_topics(tmp_path: Path) -> None:
    pytest.importorskip("cyclonedds")
    from cyclonedds import builtin
    from cyclonedds.domain import DomainParticipant

    from touchd.daemon.bridges.ros2 import Image, String

    peer = Ros2Peer(tmp_path)
    participant = DomainParticipant(peer.domain)
    topics = {"gesture": String, "event": String, "pressure": Image}
    readers = {name: reader_of(participant, f"rt/touchd/{PAD}/{name}", kind) for name, kind in topics.items()}
    offered = builtin.BuiltinDataReader(participant, builtin.BuiltinTopicDcpsPublication)
    nodes = builtin.BuiltinDataReader(participant, builtin.BuiltinTopicDcpsParticipant)
    bridge = peer.bridge()
    found: set[tuple[str, str]] = set()
    received: dict[str, list[object]] = {name: [] for name in topics}

    def all_received() -> bool:
        bridge.put(PREDICTION)
        bridge.put_frame(frame(1), PAD)
        time.sleep(0.05)
        for name, reader in readers.items():
            received[name] += reader.take(10)
        found.update((sample.topic_name, sample.type_name) for sample in offered.take(20))
        return all(received.values()) and len(found) == 3

    wait_for(all_received)
    assert f"touchd_{socket.gethostname()}" in str([node.qos for node in nodes.take(20)])
    bridge.stop(2.0)
    assert found == {
        ("rt/touchd/pad/gesture", "std_msgs::msg::dds_::String_"),
        ("rt/touchd/pad/event", "std_msgs::msg::dds_::String_"),
        ("rt/touchd/pad/pressure", "sensor_msgs::msg::dds_::Image_"),
    }
    assert received["gesture"][0] == String("stroke")
    assert decode(received["event"][0].data) == PREDICTION  # type: ignore[attr-defined]
    picture: Any = received["pressure"][0]
    assert (picture.encoding, picture.step, picture.header.frame_id) == ("mono16", 16, PAD)
    assert picture.header.stamp.sec == pytest.approx(time.time(), abs=5)
    np.testing.assert_array_equal(np.frombuffer(bytes(picture.data), "<u2").reshape(8, 8), frame(1).pressure)


def test_ros2_restarts_when_the_network_has_changed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("cyclonedds")
    from cyclonedds.core import DDSException

    from touchd.daemon.bridges import ros2

    def fail(*_: object) -> None:
        raise DDSException(DDSException.DDS_RETCODE_ERROR)

    domain = Ros2Peer(tmp_path).domain
    monkeypatch.setattr(ros2, "CHECK_S", 0.0)
    outlet = ros2.Ros2Outlet(domain, "touchd", PAD)
    outlet.send_event(PREDICTION)
    monkeypatch.setattr(ros2, "own_addresses", lambda: ["192.0.2.7"])
    with pytest.raises(BridgeError, match="the network has changed"):
        outlet.send_event(PREDICTION)
    monkeypatch.setattr(ros2, "DomainParticipant", fail)
    with pytest.raises(BridgeError, match="no network for DDS"):
        ros2.Ros2Outlet(domain, "touchd", PAD)


def test_ros2_bytes_are_those_of_the_public_definitions() -> None:
    pytest.importorskip("cyclonedds")
    stores = pytest.importorskip("rosbags.typesys")
    from touchd.daemon.bridges.ros2 import String, image

    store = stores.get_typestore(stores.Stores.ROS2_JAZZY)
    public = store.types
    assert String("stroke").serialize() == bytes(
        store.serialize_cdr(public["std_msgs/msg/String"]("stroke"), "std_msgs/msg/String")
    )
    ours = image(frame(3), PAD)
    stamp = public["builtin_interfaces/msg/Time"](ours.header.stamp.sec, ours.header.stamp.nanosec)
    theirs = public["sensor_msgs/msg/Image"](
        header=public["std_msgs/msg/Header"](stamp, PAD),
        height=8,
        width=8,
        encoding="mono16",
        is_bigendian=0,
        step=16,
        data=frame(3).pressure.astype("<u2").view(np.uint8).ravel(),
    )
    assert ours.serialize() == bytes(store.serialize_cdr(theirs, "sensor_msgs/msg/Image"))


def test_rosbridge_gets_the_topics_before_the_messages(tmp_path: Path) -> None:
    pytest.importorskip("websockets")
    peer = RosbridgePeer(tmp_path)
    peer.start()
    bridge = peer.bridge()
    bridge.put(PREDICTION)
    wait_for(lambda: peer.received)
    bridge.put_frame(frame(2), PAD)
    wait_for(lambda: len(peer.operations) == 6)
    bridge.stop(2.0)
    peer.stop()
    topics = [f"/touchd/pad/{name}" for name in ("gesture", "event", "pressure")]
    assert [(operation["op"], operation["topic"]) for operation in peer.operations] == [
        (kind, topic) for kind in ("advertise", "publish") for topic in topics
    ]
    types = [operation["type"] for operation in peer.operations[:3]]
    assert types == ["std_msgs/String", "std_msgs/String", "sensor_msgs/Image"]
    assert peer.operations[3]["msg"] == {"data": "stroke"}
    assert decode(peer.operations[4]["msg"]["data"]) == PREDICTION
    pixels = base64.b64decode(peer.operations[5]["msg"]["data"])
    np.testing.assert_array_equal(np.frombuffer(pixels, "<u2").reshape(8, 8), frame(2).pressure)


@pytest.mark.parametrize(
    ("greeting", "said"),
    [
        (b"", "the peer refused something (publish: not allowed"),
        (b"\x01\x00" + b"\x00\x00" * 20_000, "is away (it sends more than answers"),
    ],
    ids=["refusals", "a flood with the greeting"],
)
def test_what_a_rosbridge_refuses_or_sends_too_much_is_logged_once(
    greeting: bytes, said: str, caplog: pytest.LogCaptureFixture
) -> None:
    pytest.importorskip("websockets")
    port, refusals = free_port(), [0]
    refusal = '{"op":"status","level":"error","msg":"publish: not allowed\\n\\u001b[31m","id":"x"}'

    def refuse(client: Any, goes_on: Callable[[], bool]) -> None:
        attackers.welcome(client, greeting)
        while goes_on() and client.recv(65536):
            client.sendall(attackers.text(refusal.encode()))
            refusals[0] += 1
            # A message that is not a status, and one that is not valid JSON.
            client.sendall(attackers.text(b'{"op":"publish","msg":{}}') + attackers.text(b"[" * 8000))

    from touchd.daemon.bridges.rosbridge import RosbridgeBridge

    with attackers.server(port, refuse):
        bridge = RosbridgeBridge(RosbridgeSettings(url=f"ws://127.0.0.1:{port}"), "touchd", PAD)
        bridge.start()
        bridge.put(touch(1))
        wait_for(lambda: refusals[0] >= 2 or "is away" in caplog.text)
        bridge.stop(0.2)
    assert len([line for line in caplog.messages if said in line]) == 1
