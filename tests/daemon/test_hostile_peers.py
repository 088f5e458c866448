"""Peers that send without end or refuse what they get: memory stays bounded and the log short."""

import importlib.util
import resource
import socket
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from typing import Any, NamedTuple
from urllib.request import urlopen

import pytest
from rigs import attackers
from rigs.expectations import DEMO, stream_of
from rigs.peers import DDS_ON_LOOPBACK
from rigs.running_daemon import Daemon
from rigs.sockets import LISTENS, free_port, sockets
from rigs.wait import AT_ONCE_S, wait_for

from touchd.daemon.app.config import LiveSettings, PadSettings, SensorSettings
from touchd.daemon.app.log import MOST_LINES
from touchd.daemon.bridges.process import MOST_MB
from touchd.daemon.bridges.settings import LslSettings, MqttSettings, Ros2Settings, RosbridgeSettings
from touchd.daemon.playback.rig import encoder_for
from touchd.drivers.fakes.fake_port import FakePort
from touchd.drivers.robot.session import RobotSettings

# What a bridge's own process may take, and what the daemon itself may. In a minute, the process grows by 20
# MB, as a part of what it had reserved before is used then, and the daemon by 4, most of it at the beginning.
MOST_GROWTH_MB = MOST_MB + 12.0
# The log is limited by the minute, and an attack of a minute spans two. Beside the place that floods it,
# others log how each pad's connections come and go: 30 lines in a minute.
MOST_LOG_LINES = 2 * MOST_LINES + 40
SETTLING_S = 0.7
# A separate DDS domain, unlike a lab's.
DOMAIN = 77


def children(pid: int) -> list[int]:
    """Return the processes that a process started, from whichever thread."""
    found: list[int] = []
    for each in Path(f"/proc/{pid}/task").glob("*/children"):
        # A thread may end while its list is read.
        with suppress(FileNotFoundError, ProcessLookupError):
            found += map(int, each.read_text().split())
    return found


def resident_mb(pid: int) -> float:
    """Return the resident memory of a process and its children; one that has ended counts 0."""
    with suppress(FileNotFoundError, ProcessLookupError):
        pages = int(Path(f"/proc/{pid}/statm").read_text().split()[1])
        return pages * resource.getpagesize() / 1e6 + sum(map(resident_mb, children(pid)))
    return 0.0


Stranger = Callable[[attackers.Find, Callable[[], bool]], None]


@contextmanager
def stranger(pid: int, protocol: str, attack: Stranger) -> Iterator[None]:
    """Attack, in a thread, the ports of a daemon and of the processes it started, the daemon's first."""

    def find() -> list[int]:
        ports: dict[int, None] = {}
        with suppress(FileNotFoundError, ProcessLookupError):
            for kind, address, state in [one for each in (pid, *children(pid)) for one in sockets(each)]:
                if kind == protocol and (protocol == "udp" or state == LISTENS):
                    ports[int(address.split(":")[1], 16)] = None
        return list(ports)

    ended = threading.Event()
    thread = threading.Thread(target=attack, args=(find, lambda: not ended.is_set()))
    thread.start()
    try:
        yield
    finally:
        ended.set()
        thread.join()


class Attacked(NamedTuple):
    """How touchd is attacked. library: that is needed. settings: which expose touchd at a port.

    peer: attacks whatever connects to that port. stranger: attacks what listens, by this protocol.
    """

    library: str
    settings: Callable[[int], dict[str, Any]]
    peer: attackers.Attack | None = None
    stranger: tuple[str, Stranger] | None = None


def mqtt(port: int) -> dict[str, Any]:
    return {"mqtt": MqttSettings(host="127.0.0.1", port=port, pressure_hz=500)}


def rosbridge(port: int) -> dict[str, Any]:
    url = f"ws://127.0.0.1:{port}/?token=s3cret"
    return {"rosbridge": RosbridgeSettings(url=url, pressure_hz=500)}


def robot(port: int) -> dict[str, Any]:
    return {"robot": RobotSettings(url=f"tcp://127.0.0.1:{port}")}


def pad_at(scheme: str) -> Callable[[int], dict[str, Any]]:
    return lambda port: {"sensors": {scheme: PadSettings(port=f"{scheme}://127.0.0.1:{port}")}}


# Attacks at once: one by each peer, and at most one that fills the memory that a library's process may take.
TOGETHER = (
    (
        Attacked("paho.mqtt", mqtt, attackers.unfinished_publishes),
        Attacked("websockets", rosbridge, attackers.empty_fragments),
        Attacked("socket", robot, attackers.never_answers),
        Attacked("pylsl", lambda _: {"lsl": LslSettings()}, None, ("tcp", attackers.endless_lsl_request)),
    ),
    (
        Attacked("paho.mqtt", mqtt, attackers.takes_nothing),
        Attacked("websockets", rosbridge, attackers.statuses),
        Attacked("socket", robot, attackers.claims_gigabytes),
        Attacked(
            "cyclonedds",
            lambda _: {"ros2": Ros2Settings(domain=DOMAIN)},
            None,
            ("udp", attackers.dds_participants(DOMAIN)),
        ),
        Attacked("serial", pad_at("tcp"), attackers.zeros),
        Attacked("serial", pad_at("udp"), None, ("udp", attackers.datagrams)),
    ),
)


@pytest.mark.parametrize("seconds", [0.7, pytest.param(60.0, marks=pytest.mark.slow)])
@pytest.mark.parametrize("attacks", TOGETHER)
def test_peers_and_strangers_cannot_make_touchd_use_memory(
    tmp_path: Path, attacks: Sequence[Attacked], seconds: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("CYCLONEDDS_URI", DDS_ON_LOOPBACK)
    attacks = [each for each in attacks if importlib.util.find_spec(each.library.partition(".")[0])]
    ports = {attack: free_port() for attack in attacks}
    settings: dict[str, Any] = {}
    for attack, port in ports.items():
        new = attack.settings(port)
        if "sensors" in new:
            # An attacking pad replaces the simulated one.
            settings["sensor"] = SensorSettings()
            new["sensors"] |= settings.get("sensors", {})
        settings |= new
    with (
        FakePort(stream_of(DEMO), encoder_for(SensorSettings()), loop=True) as pad,
        Daemon(tmp_path, pad, **settings) as daemon,
        ExitStack() as attacked,
    ):
        wait_for(lambda: daemon.events)
        if settings.keys() & {"lsl", "ros2"}:
            wait_for(lambda: "connected to its own process" in daemon.log)
        time.sleep(SETTLING_S)
        pid = daemon.process.pid
        first_mb = most_mb = before_mb = resident_mb(pid)
        until_s = time.monotonic() + seconds
        for attack, port in ports.items():
            if attack.peer is not None:
                attacked.enter_context(attackers.server(port, attack.peer))
            if attack.stranger is not None:
                attacked.enter_context(stranger(pid, *attack.stranger))
        while time.monotonic() < until_s:
            time.sleep(0.05)
            now_mb = resident_mb(pid)
            # For a moment, a process that ends and the next one both run.
            most_mb, before_mb = max(most_mb, min(before_mb, now_mb)), now_mb
        assert daemon.process.poll() is None
        asked_s = time.monotonic()
        assert daemon.stop() == 0
        assert time.monotonic() - asked_s < 2 * AT_ONCE_S
    assert most_mb - first_mb < MOST_GROWTH_MB
    assert daemon.log.count("\n") < MOST_LOG_LINES
    assert "Traceback" not in daemon.log
    assert "s3cret" not in daemon.log
    assert daemon.log.replace("\n", "").isprintable()


def test_running_out_of_descriptors_neither_floods_the_log_nor_lasts(tmp_path: Path) -> None:
    pytest.importorskip("websockets")
    port = free_port()
    with Daemon(tmp_path, live=LiveSettings(port=port)) as daemon, ExitStack() as closing:
        wait_for(lambda: daemon.events)
        pid = daemon.process.pid
        most = len(list(Path(f"/proc/{pid}/fd").iterdir())) + 4
        resource.prlimit(pid, resource.RLIMIT_NOFILE, (most, most))
        for _ in range(6):
            closing.enter_context(socket.create_connection(("127.0.0.1", port), 5.0))
        wait_for(lambda: "Too many open files" in daemon.log)
        closing.close()

        def is_served() -> bool:
            with suppress(OSError), urlopen(f"http://127.0.0.1:{port}/", timeout=1.0) as answer:
                return bool(answer.status == 200)
            return False

        wait_for(is_served)
        assert daemon.stop() == 0
    assert daemon.log.count("\n") < 2 * MOST_LINES
