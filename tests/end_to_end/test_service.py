"""The service: notifications to systemd, the unit files, and stopping."""

import fcntl
import os
import shutil
import signal
import socket
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import pytest
from rigs.expectations import LENGTHS, expected, outline
from rigs.patient_port import PATIENT, playing
from rigs.programs import TOUCHD, Program, ran
from rigs.robots import needs_qi
from rigs.service_manager import Manager
from rigs.wait import AT_ONCE_S, WITHIN_S

from touchd.daemon.config import JournalSettings, SensorSettings, Settings
from touchd.daemon.events import SensorEvent, TouchEnded
from touchd.daemon.kept.touches import decode
from touchd.daemon.playback.rig import SpawnedDaemon, encoder_for
from touchd.daemon.service import DropLog
from touchd.daemon.systemd import Health, Notifier
from touchd.drivers.fakes.fake_port import FakePort
from touchd.drivers.fakes.hand import simulate
from touchd.drivers.recording import splice
from touchd.drivers.robot.session import RobotSettings

UNITS = Path(__file__).parents[2] / "systemd"


@pytest.fixture
def manager(tmp_path: Path) -> Iterator[Manager]:
    manager = Manager(tmp_path)
    yield manager
    manager.close()


@pytest.fixture
def health(manager: Manager) -> Iterator[Health]:
    notifier = Notifier(manager.environ)
    yield Health(notifier)
    notifier.close()


@pytest.mark.parametrize("environ", [{}, {"NOTIFY_SOCKET": "/nowhere/nobody"}])
def test_without_a_service_manager_nothing_fails(environ: dict[str, str]) -> None:
    notifier = Notifier(environ)
    notifier.send(READY=1)
    assert notifier.watchdog_s == 0
    notifier.close()


def test_a_service_manager_in_the_abstract_namespace_is_notified() -> None:
    name = f"touchd-test-{os.getpid()}"
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as manager:
        manager.bind(f"\0{name}")
        manager.setblocking(False)
        notifier = Notifier({"NOTIFY_SOCKET": f"@{name}"})
        notifier.send(READY=1)
        notifier.close()
        assert manager.recv(100) == b"READY=1"


def test_a_watchdog_for_another_process_is_ignored() -> None:
    assert Notifier({"WATCHDOG_USEC": "1000000", "WATCHDOG_PID": "1"}).watchdog_s == 0
    assert Notifier({"WATCHDOG_USEC": "1000000", "WATCHDOG_PID": str(os.getpid())}).watchdog_s == 1.0


def test_ready_is_sent_once_the_pads_state_is_known(manager: Manager, health: Health) -> None:
    health.feed()
    assert manager.received() == []
    health.pad_state("pad", up=False)
    health.pad_state("pad", up=True)
    assert manager.received().count("READY=1") == 1


def test_the_watchdog_is_fed_while_the_pad_is_away(manager: Manager, health: Health) -> None:
    health.pad_state("pad", up=False)
    assert "WATCHDOG=1" in manager.received()


@pytest.mark.parametrize(("silent", "fed"), [("pad", []), ("nobody", ["WATCHDOG=1"])])
def test_the_watchdog_starves_when_one_present_pad_is_silent(
    manager: Manager, health: Health, monkeypatch: pytest.MonkeyPatch, silent: str, fed: list[str]
) -> None:
    now_s = time.monotonic()
    health.pad_state("pad", up=True)
    health.pad_state("away", up=False)
    manager.received()
    monkeypatch.setattr(time, "monotonic", lambda: now_s + 2000)
    health.report(touches=0, dropped=0)
    if silent == "nobody":
        health.frame_processed("pad")
    health.feed()
    assert [line for line in manager.received() if "WATCHDOG" in line] == fed


def test_the_watchdog_is_not_fed_more_often_than_it_needs(manager: Manager, health: Health) -> None:
    for _ in range(1000):
        health.frame_processed("pad")
    assert manager.received() == ["WATCHDOG=1"]


def test_the_status_shows_rate_touches_and_drops(
    manager: Manager, health: Health, monkeypatch: pytest.MonkeyPatch
) -> None:
    now_s = time.monotonic()
    for _ in range(540):
        health.frame_processed("pad")
    health.pad_state("arm", up=False)
    monkeypatch.setattr(time, "monotonic", lambda: now_s + 10)
    health.report(touches=3, dropped=7)
    status = manager.received()[-1]
    assert status.startswith("STATUS=5")
    assert status.endswith(" frames/s, arm away, 3 touches, 7 frames dropped")


def test_each_status_and_warning_counts_from_the_one_before(
    manager: Manager, health: Health, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    now_s = time.monotonic()
    monkeypatch.setattr(time, "monotonic", lambda: now_s)
    drops = DropLog()
    for passed_s, frames, dropped in ((10, 540, 7), (10, 270, 9), (10, 0, 9)):
        for _ in range(frames):
            health.frame_processed("pad")
        now_s += passed_s
        health.report(touches=0, dropped=dropped)
        drops.update({"pad": dropped})
    rates = [line.split()[0] for line in manager.received() if line.startswith("STATUS=")]
    assert rates[1:] == ["STATUS=27.0", "STATUS=0.0"]
    warned = [record.getMessage().partition(":")[2].split(":")[0] for record in caplog.records]
    assert warned == [" 7 frames dropped", " 2 frames dropped"]


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
    stream = splice(simulate([("notouch", 2.0), ("rub", 3.0), ("notouch", 30.0)], seed=3))
    with FakePort(stream, encoder_for(SensorSettings()), speed=4.0) as port:
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


def test_a_signal_ends_the_daemon_before_systemd_would(spawn: Spawn, manager: Manager, pad: FakePort) -> None:
    daemon = spawn(pad.path)
    manager.await_ready()
    asked_s = time.monotonic()
    daemon.process.terminate()
    assert daemon.process.wait(WITHIN_S) == 0
    assert time.monotonic() - asked_s < AT_ONCE_S
    assert daemon.stop() == 0
    assert "STOPPING=1" in manager.received()


def test_no_burst_of_signals_hangs_or_fails_the_daemon(tmp_path: Path, pad: FakePort) -> None:
    with (tmp_path / "log").open("wb") as log:
        daemon = SpawnedDaemon(Settings(sensor=SensorSettings(port=pad.path)), tmp_path, log)
        try:
            next(daemon.events())
            for _ in range(400):
                daemon.process.send_signal(signal.SIGHUP)
                daemon.process.send_signal(signal.SIGHUP)
            assert any(isinstance(event, TouchEnded) for event in daemon.events())
            # Until it has ended, also while the interpreter shuts down.
            for _ in range(400):
                daemon.process.send_signal(signal.SIGTERM)
                daemon.process.send_signal(signal.SIGINT)
                time.sleep(0.002)
            assert daemon.process.wait(WITHIN_S) == 0
        finally:
            daemon.stop()
    log_text = (tmp_path / "log").read_text()
    assert log_text.count("SIGHUP is ignored") == 1, log_text
    assert "Traceback" not in log_text


def test_under_nohup_a_closed_terminal_does_not_end_it(pad: FakePort) -> None:
    with Program("nohup", *TOUCHD, "run", "--port", pad.path, "--json") as daemon:
        next(daemon.stdout)
        daemon.send_signal(signal.SIGHUP)
        assert any(isinstance(decode(line), TouchEnded) for line in daemon.stdout)
        daemon.terminate()
        assert daemon.wait(WITHIN_S) == 0


def test_a_missing_pad_is_awaited_and_reported(spawn: Spawn, tmp_path: Path, manager: Manager) -> None:
    daemon = spawn(str(tmp_path / "pad"))
    manager.await_ready()
    event = next(daemon.events())
    assert (type(event), event.state) == (SensorEvent, "down")
    assert "is not there" in event.reason
    # As Ctrl-C does.
    daemon.process.send_signal(signal.SIGINT)
    assert daemon.process.wait(AT_ONCE_S) == 0


@needs_qi
def test_a_stalled_reader_and_dead_robot_lose_no_journal_line(spawn: Spawn, tmp_path: Path) -> None:
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
        assert time.monotonic() - asked_s < AT_ONCE_S
        daemon.stop()
    assert outline(map(decode, path.read_bytes().splitlines())) == expected(LENGTHS)


def test_a_reader_that_goes_away_ends_the_daemon_cleanly(spawn: Spawn, pad: FakePort) -> None:
    daemon = spawn(pad.path)
    daemon.process.stdout.readline()
    daemon.process.stdout.close()
    assert daemon.process.wait(WITHIN_S) == 0
