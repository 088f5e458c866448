"""Retries back off while a peer is missing, and start again quickly after it was there."""

import time
from collections.abc import Callable
from contextlib import closing
from pathlib import Path

import pytest
from rigs.formats import encode_fabric_grid
from rigs.made_events import touch
from rigs.peers import RosbridgePeer
from rigs.robots import linked
from rigs.sensor_rig import next_frames, sensing, stream_of
from rigs.wait import wait_for

from touchd.drivers.backoff import Backoff
from touchd.drivers.fakes.fake_port import FakePort
from touchd.drivers.fakes.stub_robot import StubRobot
from touchd.drivers.robot.limits import RobotLimits

Paused = Callable[[str], list[float]]


@pytest.fixture
def paused(monkeypatch: pytest.MonkeyPatch) -> Paused:
    """Records the pauses that a module takes."""

    def record(module: str) -> list[float]:
        pauses: list[float] = []

        class Recorded(Backoff):
            def pause_s(self) -> float:
                pauses.append(super().pause_s())
                return pauses[-1]

        monkeypatch.setattr(f"{module}.Backoff", Recorded)
        return pauses

    return record


def first(pauses: list[float]) -> float:
    wait_for(lambda: len(pauses) > 0)
    return pauses[0]


def test_attempts_back_off_and_recover() -> None:
    backoff = Backoff(0.1, 1.0)
    for longest in (0.1, 0.2, 0.4, 0.8, 1.0, 1.0, 1.0, 1.0):
        assert longest / 2 <= backoff.pause_s() <= longest
    backoff.reset()
    assert backoff.pause_s() <= 0.1


def test_a_missing_pad_is_retried_at_the_cap_a_lost_one_quickly(tmp_path: Path, paused: Paused) -> None:
    pauses = paused("touchd.drivers.pad.sensor")
    link = tmp_path / "pad"
    with sensing(str(link), longest_retry_s=0.3) as queue:
        wait_for(lambda: len(pauses) > 3)
        assert 0.15 <= pauses[3] <= max(pauses) <= 0.3
        with FakePort(stream_of(), encode_fabric_grid) as port:
            link.symlink_to(port.path)
            next_frames(queue, 5)
            time.sleep(0.4)
            link.unlink()
            pauses.clear()
        assert first(pauses) <= 0.1


def test_a_lost_robot_is_retried_quickly(paused: Paused) -> None:
    pauses = paused("touchd.drivers.robot.worker")
    robot = StubRobot()
    with linked(robot, limits=RobotLimits(backoff_first_s=0.02)) as (_, states):
        wait_for(lambda: pauses[-1:] > [0.1])
        robot.start()
        states.wait_for("down", "up")
        pauses.clear()
        robot.kill()
        assert first(pauses) <= 0.02


def test_a_bridge_retries_a_lost_peer_quickly(tmp_path: Path, paused: Paused) -> None:
    pytest.importorskip("websockets")
    pauses = paused("touchd.daemon.bridges.bridge")
    with closing(RosbridgePeer(tmp_path)) as peer:
        bridge = peer.bridge()
        wait_for(lambda: pauses[-1:] > [0.2])
        peer.start()
        bridge.put(touch(1))
        peer.await_heard(1)
        pauses.clear()
        peer.stop()
        assert first(pauses) <= 0.1
