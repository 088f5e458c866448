"""The service: notifications to systemd, the unit files, udev rules, and stopping."""

import fcntl
import os
import re
import shutil
import signal
import socket
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, closing
from dataclasses import dataclass, replace
from fnmatch import fnmatchcase
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from rigs.expectations import LENGTHS, expected, outline
from rigs.patient_port import PATIENT, playing
from rigs.programs import TOUCHD, Program, ran
from rigs.service_manager import Manager
from rigs.wait import AT_ONCE_S, WITHIN_S

from touchd.daemon.app.config import JournalSettings, PadSettings, SceneSettings, SensorSettings, Settings
from touchd.daemon.app.parts import PadChannel
from touchd.daemon.app.systemd import Health
from touchd.daemon.path import service as daemon_loop
from touchd.daemon.path.events import Event, SensorEvent, TouchEnded, encode
from touchd.daemon.path.service import Service
from touchd.daemon.playback.rig import SpawnedDaemon, encoder_for
from touchd.daemon.robot.actions import Action, ActionRule
from touchd.daemon.sinks.sink import EventFanout, LinesSink
from touchd.daemon.sinks.touches import decode
from touchd.drivers.fakes.fake_port import FakePort
from touchd.drivers.frame import Frame
from touchd.drivers.recording import splice
from touchd.drivers.robot.session import RobotSettings
from touchd.model.studies.simulated import simulate

UNITS = Path(__file__).parents[2] / "systemd"
FRAME = Frame(0, 0.0, np.zeros((8, 8), np.uint16))


@pytest.fixture
def manager(tmp_path: Path) -> Iterator[Manager]:
    manager = Manager(tmp_path)
    yield manager
    manager.close()


@dataclass
class Watched:
    """Two pads as the loop leaves them, and what is told about them."""

    health: Health
    pad: PadChannel
    arm: PadChannel

    def processes(self, frames: int) -> None:
        """Process frames of the pad, one a turn."""
        for _ in range(frames):
            self.pad.frames, self.pad.is_up = self.pad.frames + 1, True
            self.health.update()


@pytest.fixture
def watched(manager: Manager) -> Iterator[Watched]:
    settings = Settings(sensors={name: PadSettings(port=f"/dev/{name}") for name in ("pad", "arm")})
    service = Service(settings)
    pad, arm = service.pads
    with closing(Health(manager.environ, service.pads, service.events)) as health:
        yield Watched(health, pad, arm)


def stopping(environ: dict[str, str]) -> float:
    """Tell a manager that the daemon stops; return how often it has to be fed, in seconds."""
    with closing(Health(environ, (), EventFanout())) as health:
        assert health.update(is_ending=True)
        return health.watchdog_s


@pytest.mark.parametrize("environ", [{}, {"NOTIFY_SOCKET": "/nowhere/nobody"}])
def test_without_a_service_manager_nothing_fails(environ: dict[str, str]) -> None:
    assert stopping(environ) == 0


def test_a_service_manager_in_the_abstract_namespace_is_notified() -> None:
    name = f"touchd-test-{os.getpid()}"
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as manager:
        manager.bind(f"\0{name}")
        manager.setblocking(False)
        stopping({"NOTIFY_SOCKET": f"@{name}"})
        assert manager.recv(100) == b"STOPPING=1"


def test_a_watchdog_for_another_process_is_ignored() -> None:
    assert stopping({"WATCHDOG_USEC": "1000000", "WATCHDOG_PID": "1"}) == 0
    assert stopping({"WATCHDOG_USEC": "1000000", "WATCHDOG_PID": str(os.getpid())}) == 1.0


def test_ready_is_sent_once_the_pads_state_is_known(manager: Manager, watched: Watched) -> None:
    watched.health.update()
    assert manager.received() == []
    watched.pad.is_up = False
    watched.health.update()
    watched.pad.is_up = True
    watched.health.update()
    assert manager.received().count("READY=1") == 1


def test_the_watchdog_is_fed_while_the_pad_is_away(manager: Manager, watched: Watched) -> None:
    watched.pad.is_up = False
    watched.health.update()
    assert "WATCHDOG=1" in manager.received()


@pytest.mark.parametrize(("silent", "fed"), [("pad", []), ("nobody", ["WATCHDOG=1"])])
def test_the_watchdog_starves_when_one_present_pad_is_silent(
    manager: Manager, watched: Watched, monkeypatch: pytest.MonkeyPatch, silent: str, fed: list[str]
) -> None:
    now_s = time.monotonic()
    watched.pad.is_up, watched.arm.is_up = True, False
    watched.health.update()
    manager.received()
    monkeypatch.setattr(time, "monotonic", lambda: now_s + 2000)
    watched.pad.frames += silent == "nobody"
    watched.health.update()
    assert [line for line in manager.received() if "WATCHDOG" in line] == fed


def test_the_watchdog_is_not_fed_more_often_than_it_needs(manager: Manager, watched: Watched) -> None:
    watched.processes(1000)
    assert manager.received() == ["READY=1", "WATCHDOG=1"]


@pytest.fixture
def now_s(monkeypatch: pytest.MonkeyPatch) -> list[float]:
    """The time, which stands still unless the test changes it."""
    now_s = [time.monotonic()]
    monkeypatch.setattr(time, "monotonic", lambda: now_s[0])
    return now_s


# The time stands still before anything is watched.
def test_each_status_counts_from_the_one_before(
    now_s: list[float], manager: Manager, watched: Watched
) -> None:
    watched.arm.is_up = False
    watched.pad.queue.dropped, watched.arm.queue.dropped = 3, 4
    watched.processes(1)
    for passed_s, frames in ((10, 540), (10, 270), (10, 0)):
        watched.pad.frames += frames
        now_s[0] += passed_s
        watched.health.update()
    ends = " frames/s, arm away, 0 touches, 7 frames dropped"
    statuses = [line for line in manager.received() if line.startswith("STATUS=")]
    assert statuses == [f"STATUS={rate}{ends}" for rate in ("54.1", "27.0", "0.0")]


def test_dropped_frames_are_logged_until_the_queue_is_empty(caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level("INFO")
    service = Service(Settings(sensor=SensorSettings(port="/dev/nobody")))
    service.add_sink(LinesSink("stdout", os.open(os.devnull, os.O_WRONLY), encode))
    (pad,) = service.pads
    pad.queue.put_all([FRAME] * 600)
    service.run(lambda: True)
    begun, ended, in_all = (record.message for record in caplog.records if "dropped" in record.message)
    assert begun.startswith("pad: frames dropped: the machine is too busy")
    processed, _, dropped = re.findall(r"\d+", in_all)
    assert ended.startswith(f"pad: no frames are dropped any more; {dropped} were")
    assert int(processed) + int(dropped) == 600


def test_an_overloaded_daemon_stops_in_time_and_counts_the_rest(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    caplog.set_level("INFO")
    monkeypatch.setattr("touchd.daemon.path.service.DRAIN_S", 0.2)
    service = Service(Settings(sensor=SensorSettings(port="/dev/nobody"), journal=None))
    (pad,) = service.pads
    monkeypatch.setattr(pad.pipeline, "on_frame", lambda _: time.sleep(0.02))
    # It would add that the port is missing.
    monkeypatch.setattr(pad.sensor, "start", lambda: None)
    pad.queue.put_all([FRAME] * 500)
    service.run(lambda: True)
    assert 0 < pad.frames <= 20
    assert f"{pad.frames} frames, 0 touches, {500 - pad.frames} frames dropped in all" in caplog.text


def test_its_own_limits_end_before_systemd_kills_it() -> None:
    limit_s = re.search(r"^TimeoutStopSec=(\d+)$", (UNITS / "touchd.service").read_text(), re.MULTILINE)
    assert limit_s is not None
    limits_s = daemon_loop.SENSORS_STOP_S + daemon_loop.DRAIN_S + daemon_loop.SINKS_STOP_S
    assert limits_s <= int(limit_s[1]) - 1


@pytest.mark.parametrize(
    ("watched", "bridged", "together"), [(False, None, 3), (True, None, 1), (False, 54.0, 1)]
)
def test_frames_are_read_singly_while_somebody_is_shown_them(
    watched: bool, bridged: float | None, together: int
) -> None:
    rest = splice(simulate((("notouch", 5.0),), seed=1))
    with FakePort(rest, encoder_for(SensorSettings()), speed=8.0) as port:
        service = Service(Settings(sensor=SensorSettings(port=port.path), journal=None))
        taker = {"put_frame": lambda *_: None}
        service.watchers.append(SimpleNamespace(is_watched=watched, put=print, **taker))
        service.parts = replace(service.parts, bridges=(SimpleNamespace(frames_hz=bridged, **taker),))
        (pad,) = service.pads
        until_s = time.monotonic() + WITHIN_S
        service.run(lambda: pad.frames > 100 or time.monotonic() > until_s)
    assert (pad.frames > 100, pad.sensor.frames_together) == (True, together)


class MeetingSink:
    """A sink that stops once all others but the last one stop too."""

    def __init__(self, stopped: list["MeetingSink"], others: threading.Barrier) -> None:
        self._stopped, self._others = stopped, others

    def start(self) -> None: ...

    def put(self, event: Event) -> None: ...

    def stop(self, timeout_s: float) -> None:
        # Less than a second for the robot, and for the others.
        assert 0.3 < timeout_s < 1.0
        if self._stopped:
            self._others.wait(AT_ONCE_S)
        self._stopped.append(self)


def test_the_robots_sink_stops_first_then_all_others_at_once() -> None:
    service = Service(Settings(sensor=SensorSettings(port="/dev/nobody")))
    stopped, others = list[MeetingSink](), threading.Barrier(3)
    sinks = [MeetingSink(stopped, others) for _ in range(4)]
    for sink in sinks:
        service.add_sink(sink)
    service.run(lambda: True)
    assert (stopped[0], set(stopped), len(stopped)) == (sinks[-1], set(sinks), 4)


def needs(program: str) -> pytest.MarkDecorator:
    return pytest.mark.skipif(shutil.which(program) is None, reason=f"{program} is not installed")


@needs("systemd-analyze")
def test_systemd_accepts_the_unit(tmp_path: Path) -> None:
    root = tmp_path / "root"
    shutil.copytree("/usr/lib/systemd/system", root / "usr/lib/systemd/system", symlinks=True)
    (root / "etc/systemd/system").mkdir(parents=True)
    shutil.copy(UNITS / "touchd.service", root / "etc/systemd/system")
    for program in (root / "opt/touchd/bin/touchd", root / "bin/kill"):
        program.parent.mkdir(parents=True)
        program.write_text("#!/bin/sh\n")
        program.chmod(0o755)
    done = ran(["systemd-analyze", "verify", f"--root={root}", "touchd.service"])
    assert done.returncode == 0, done.stderr
    assert "touchd" not in done.stderr


@needs("systemd-analyze")
def test_the_unit_is_exposed_as_little_as_possible() -> None:
    options = ["--offline=true", "--no-pager", "--threshold=20"]
    done = ran(["systemd-analyze", "security", *options, UNITS / "touchd.service"])
    assert done.returncode == 0, done.stdout[-400:]


@needs("systemd-sysusers")
def test_systemd_accepts_the_user() -> None:
    done = ran(["systemd-sysusers", "--dry-run", str(UNITS / "touchd.sysusers.conf")])
    assert done.returncode == 0, done.stderr


@pytest.fixture
def pad() -> Iterator[FakePort]:
    stream = splice(simulate([("notouch", 2.0), ("rub", 2.0), ("notouch", 30.0)], seed=3))
    with FakePort(stream, encoder_for(SensorSettings()), speed=8.0) as port:
        yield port


Spawn = Callable[..., SpawnedDaemon]


@pytest.fixture
def spawn(tmp_path: Path, manager: Manager) -> Iterator[Spawn]:
    """Spawns daemons on a port; stops them after the test."""
    with ExitStack() as closing:

        def spawn(port: str, **others: Any) -> SpawnedDaemon:
            settings = Settings(sensor=SensorSettings(port=port), **others)
            daemon = SpawnedDaemon(settings, tmp_path, None, manager.environ)
            closing.callback(daemon.stop)
            return daemon

        yield spawn


def test_no_burst_of_signals_hangs_or_fails_the_daemon(tmp_path: Path, pad: FakePort) -> None:
    with (tmp_path / "log").open("wb") as log:
        daemon = SpawnedDaemon(Settings(sensor=SensorSettings(port=pad.path)), tmp_path, log)
        try:
            next(daemon.events())
            for _ in range(400):
                daemon.process.send_signal(signal.SIGHUP)
                daemon.process.send_signal(signal.SIGHUP)
            assert any(isinstance(event, TouchEnded) for event in daemon.events())
            # Also while the interpreter shuts down.
            for _ in range(400):
                daemon.process.send_signal(signal.SIGTERM)
                daemon.process.send_signal(signal.SIGINT)
                if daemon.process.poll() is not None:
                    break
                time.sleep(0.002)
            assert daemon.process.wait(WITHIN_S) == 0
        finally:
            daemon.stop()
    assert "Traceback" not in (tmp_path / "log").read_text()


def test_under_nohup_a_closed_terminal_does_not_end_it(pad: FakePort) -> None:
    with Program("nohup", *TOUCHD, "run", "--port", pad.path, "--json") as daemon:
        next(daemon.stdout)
        daemon.send_signal(signal.SIGHUP)
        assert any(isinstance(decode(line), TouchEnded) for line in daemon.stdout)
        daemon.terminate()
        assert daemon.wait(WITHIN_S) == 0


def test_a_missing_pad_or_robot_is_reported(
    spawn: Spawn, tmp_path: Path, manager: Manager, capfd: pytest.CaptureFixture[str]
) -> None:
    scene = SceneSettings(actions=(ActionRule(do=(Action(say="Oh"),)),))
    daemon = spawn(str(tmp_path / "pad"), scene=scene)
    manager.await_ready()
    event = next(daemon.events())
    assert (type(event), event.state) == (SensorEvent, "down")
    assert "is not there" in event.reason
    # As Ctrl-C does.
    daemon.process.send_signal(signal.SIGINT)
    assert daemon.process.wait(AT_ONCE_S) == 0
    assert "scene.actions: no robot is configured, so nothing acts" in capfd.readouterr().err


def test_a_stalled_reader_and_dead_robot_lose_no_journal_line(
    spawn: Spawn, tmp_path: Path, manager: Manager
) -> None:
    path = tmp_path / "events.jsonl"
    with playing(LENGTHS, 50.0) as pad:
        robot, journal = RobotSettings(url="tcp://127.0.0.1:9"), JournalSettings(path=str(path))
        daemon = spawn(pad.path, robot=robot, journal=journal, scene=PATIENT)
        fcntl.fcntl(daemon.process.stdout, fcntl.F_SETPIPE_SZ, 4096)
        pad.reader = daemon.process.pid
        assert pad.wait(WITHIN_S)
        pad.settle()
        asked_s = time.monotonic()
        daemon.process.terminate()
        assert daemon.process.wait(WITHIN_S) == 0
        # Before systemd would kill it.
        assert time.monotonic() - asked_s < AT_ONCE_S
        daemon.stop()
    assert "STOPPING=1" in manager.received()
    assert outline(map(decode, path.read_bytes().splitlines())) == expected(LENGTHS)


def test_a_reader_that_goes_away_ends_the_daemon_cleanly(spawn: Spawn, pad: FakePort) -> None:
    daemon = spawn(pad.path)
    daemon.process.stdout.readline()
    daemon.process.stdout.close()
    assert daemon.process.wait(WITHIN_S) == 0


SYSTEMD = Path(__file__).parents[2] / "systemd"
ALLOWED = [
    line.split("=")[1].split()[0].removeprefix("char-")
    for line in (SYSTEMD / "touchd.service").read_text().splitlines()
    if line.startswith("DeviceAllow=")
]


@pytest.mark.parametrize(
    ("driver", "is_allowed"),
    [
        *((name, True) for name in ("ttyACM", "ttyUSB", "ttyAMA", "ttyS", "ttyTHS", "ttymxc", "rfcomm")),
        *((name, True) for name in ("ttyCH343USB", "ttyCH341USB", "ttyXRUSB", "ttyAML", "ttySC", "ttyGS")),
        *((name, False) for name in ("tty", "ttyprintk", "mem", "input", "sg", "hidraw", "ptm", "video")),
    ],
)
def test_the_service_may_open_serial_ports_alone(driver: str, is_allowed: bool) -> None:
    # As systemd matches the names in /proc/devices.
    assert any(fnmatchcase(driver, pattern) for pattern in ALLOWED) is is_allowed


def properties_of(vendor: str, product: str) -> dict[str, str]:
    """Return what the rules assign to a tty of this USB board."""
    board, assigned = {"idVendor": vendor, "idProduct": product}, dict[str, str]()
    for line in (SYSTEMD / "99-touchd.rules").read_text().splitlines():
        wanted = re.findall(r'ATTRS\{(\w+)\}=="([^"]*)"', line)
        if line.startswith("ATTRS") and all(
            any(fnmatchcase(board[name], each) for each in pattern.split("|")) for name, pattern in wanted
        ):
            assigned |= dict(re.findall(r'(\w+(?:\{\w+\})?)\+?="([^"]*)"', line))
    return assigned


@pytest.mark.parametrize(
    ("vendor", "product", "has_name"),
    [
        pytest.param("2341", "0042", True, id="Mega"),
        pytest.param("2a03", "0042", True, id="Mega.org"),
        pytest.param("16c0", "0483", True, id="Teensy"),
        pytest.param("2341", "0043", False, id="Uno"),
        pytest.param("2341", "8036", False, id="Leonardo"),
        pytest.param("2e8a", "000a", False, id="RP2040"),
        pytest.param("303a", "1001", False, id="ESP32-S3"),
        pytest.param("10c4", "ea60", False, id="CP210x"),
        pytest.param("0403", "6001", False, id="FTDI"),
        pytest.param("1a86", "7523", False, id="CH340"),
        pytest.param("1a86", "55d4", False, id="CH9102"),
    ],
)
def test_modem_commands_are_kept_from_the_usual_boards(vendor: str, product: str, has_name: bool) -> None:
    assigned = properties_of(vendor, product)
    assert assigned["ENV{ID_MM_DEVICE_IGNORE}"] == "1"
    assert (assigned.get("SYMLINK") == "touchd-pad") is has_name


def test_a_modem_is_left_to_its_manager() -> None:
    assert properties_of("12d1", "1506") == {}
