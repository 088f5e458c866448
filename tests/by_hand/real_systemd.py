"""The service under a real systemd, installed by `make install`: make test-systemd (root; systemd-container).

It takes too long for the suite; its file name keeps it out.
"""

import json
import sys
import time
from collections.abc import Iterator

import pytest
from by_hand.debian_container import WHY_NOT, Container, booted
from rigs.expectations import LENGTHS

from touchd.daemon.path.events import Event, Prediction, SensorEvent, TouchBegan, TouchEnded, epoch_s
from touchd.daemon.sinks.touches import decode

INSTALL = "cd /root/touchd && PIP_NO_INDEX=1 PIP_FIND_LINKS=/mnt/wheels make install"
CONFIGURATION = """
robot: {url: "tcp://127.0.0.1:9559"}
journal: {path: /var/lib/touchd/events.jsonl}
"""
# The pad is a pty.
FOR_THE_PTY = "[Service]\nDeviceAllow=char-pts rw\n"
DROP_INS = "/etc/systemd/system/touchd.service.d"
EVENTS = "/var/lib/touchd/events.jsonl"

PAD = f"""[Service]
ExecStart=/opt/touchd/bin/python /mnt/helpers/pad.py /mnt/recordings/{LENGTHS.name}
"""
ROBOT = """[Service]
DynamicUser=yes
ExecStart=/opt/touchd/bin/touchd fake-robot
"""
PROBE = """[Service]
Type=oneshot
Restart=no
StandardOutput=truncate:/run/probe
ExecStart=
ExecStart=/opt/touchd/bin/python /opt/touchd/probe.py
"""
LOG = "journalctl -o cat --since $(cat /run/since)"

pytestmark = [pytest.mark.timeout(3600), pytest.mark.skipif(bool(WHY_NOT), reason=WHY_NOT)]


@pytest.fixture(scope="session")
def lab() -> Iterator[Container]:
    """A machine with touchd installed."""
    with booted() as machine:
        machine.run("cp -r /mnt/touchd /root/touchd")
        # A strict umask of root's must not keep the service from its own program.
        machine.run(f"umask 077; {INSTALL}", 1800)
        machine.run(f"mkdir -p {DROP_INS}")
        machine.write(f"{DROP_INS}/lab.conf", FOR_THE_PTY)
        machine.write("/etc/systemd/system/pad.service", PAD)
        machine.write("/etc/systemd/system/robot.service", ROBOT)
        machine.run("systemctl daemon-reload")
        yield machine


@pytest.fixture
def touchd(lab: Container) -> Iterator[Container]:
    """The machine with pad, robot and the service running."""
    lab.run("date +@%s.%6N > /run/since")
    plug_in(lab)
    lab.run("systemctl start robot")
    lab.wait_until(f"{LOG} -u robot | grep -q listening")
    lab.write("/etc/touchd/touchd.yaml", CONFIGURATION)
    lab.run("systemctl start touchd", 900)
    yield lab
    lab.run("systemctl stop touchd robot; systemctl reset-failed; rm -rf /var/lib/touchd/*", 900)
    unplug(lab)


def plug_in(lab: Container) -> None:
    lab.run("systemctl start pad")
    lab.wait_until("test -e /dev/touchd-pad")


def unplug(lab: Container) -> None:
    lab.run("systemctl stop pad")
    lab.wait_until("test ! -e /dev/touchd-pad")


def shown(lab: Container, *names: str) -> list[str]:
    """Return the service's properties from systemd."""
    lines = lab.run(f"systemctl show touchd -p {','.join(names)}").splitlines()
    told = dict(line.split("=", 1) for line in lines)
    return [told[name] for name in names]


def await_events(lab: Container, count: int) -> list[Event]:
    """Wait until the journal of events has `count` lines; returns these events."""
    lab.wait_until(f"test $(wc -l < {EVENTS}) -ge {count}", 60)
    return [decode(line) for line in lab.run(f"head -n {count} {EVENTS}").splitlines()]


def await_more_events(lab: Container, count: int) -> None:
    """Wait until the journal of events has `count` more lines; all must be whole."""
    await_events(lab, int(lab.run(f"wc -l < {EVENTS}")) + count)


def await_status(lab: Container, pattern: str) -> str:
    """Wait until the status matches; returns it."""
    lab.wait_until(f"systemctl show touchd -p StatusText | grep -Eq '{pattern}'")
    return shown(lab, "StatusText")[0]


def test_ready_waits_for_the_model_and_the_pad(touchd: Container) -> None:
    assert shown(touchd, "Type", "ActiveState", "NRestarts") == ["notify", "active", "0"]
    # The robot may be found before the pad.
    found = next(event for event in await_events(touchd, 2) if isinstance(event, SensorEvent))
    ready = touchd.run("systemctl show touchd -P ActiveEnterTimestamp --timestamp=us")
    assert epoch_s(found.time) <= float(touchd.run(f"date -d '{ready}' +%s.%N"))


def test_events_reach_journal_log_and_robot(touchd: Container) -> None:
    events = await_events(touchd, 8)
    assert {TouchBegan, Prediction, TouchEnded} <= {type(event) for event in events}
    assert '"type":"prediction"' in touchd.run(f"{LOG} -u touchd")
    assert "TouchGesture/Gesture" in touchd.run(f"{LOG} -u robot")
    assert touchd.run(f"stat -c '%U %a' {EVENTS}") == "touchd 600"


def test_a_wrong_configuration_stops_the_service_without_restarts(touchd: Container) -> None:
    touchd.run("systemctl stop touchd", 300)
    touchd.write("/etc/touchd/touchd.yaml", "sensr: {}\n")
    assert not touchd.succeeds("systemctl start touchd")
    time.sleep(3.0)
    assert shown(touchd, "ActiveState", "ExecMainStatus", "NRestarts") == ["failed", "2", "0"]
    assert "did you mean sensor?" in touchd.run(f"{LOG} -u touchd | grep sensr")


def test_the_watchdog_restarts_it_when_it_hangs(touchd: Container) -> None:
    await_events(touchd, 2)
    before = shown(touchd, "MainPID")
    touchd.run("kill -STOP $(systemctl show touchd -P MainPID)")
    took_s = touchd.wait_until("test $(systemctl show touchd -P NRestarts) = 1", 40)
    touchd.wait_until("systemctl is-active -q touchd")
    assert "Watchdog timeout" in touchd.run(f"{LOG} -u touchd")
    assert shown(touchd, "MainPID") != before
    sys.stdout.write(f"restarted {took_s:.0f} s after it hung\n")


def test_the_watchdog_tolerates_a_missing_pad(touchd: Container) -> None:
    unplug(touchd)
    await_status(touchd, "pad away")
    # Longer than the watchdog's ten seconds.
    time.sleep(15.0)
    plug_in(touchd)
    await_status(touchd, "^StatusText=[0-9.]+ frames/s")
    assert shown(touchd, "NRestarts") == ["0"]


def test_a_killed_service_restarts_with_whole_journal_lines(touchd: Container) -> None:
    await_events(touchd, 4)
    touchd.run("systemctl kill -s KILL touchd")
    touchd.wait_until("test $(systemctl show touchd -P NRestarts) = 1")
    touchd.wait_until("systemctl is-active -q touchd")
    await_more_events(touchd, 4)


def test_it_runs_as_its_own_user_without_any_privilege(touchd: Container) -> None:
    pid = shown(touchd, "MainPID")[0]
    status = dict(line.split(":", 1) for line in touchd.run(f"cat /proc/{pid}/status").splitlines())
    user = touchd.run("id -u touchd")
    assert set(status["Uid"].split()) == {user}
    assert [status[name].strip() for name in ("NoNewPrivs", "Seccomp")] == ["1", "2"]
    assert {int(status[f"Cap{name}"], 16) for name in ("Inh", "Prm", "Eff", "Bnd", "Amb")} == {0}


def test_the_sandbox_allows_nothing_but_its_work(touchd: Container) -> None:
    await_status(touchd, "frames/s")
    touchd.run("mkdir -p /home/somebody; mknod -m 666 /dev/touchd-probe c 1 11 2>/dev/null || true")
    touchd.run("cp /mnt/helpers/probe.py /opt/touchd/probe.py; systemctl stop touchd", 300)
    # Run the probe instead of the program, under all the unit's rules.
    touchd.write(f"{DROP_INS}/probe.conf", PROBE)
    touchd.run("systemctl daemon-reload; systemctl start touchd", 900)
    touchd.run(f"rm {DROP_INS}/probe.conf; systemctl daemon-reload")
    outcome = json.loads(touchd.run("cat /run/probe"))
    could = {attempt for attempt, how in outcome.items() if how == "done"}
    assert could == {"write its state", "read its configuration", "open the pad", "reach the robot"}


def test_systemd_rates_its_exposure_at_most_2(lab: Container) -> None:
    said = lab.run("systemd-analyze security touchd | tail -n 1")
    assert float(said.split(":")[1].split()[0]) <= 2.0
    sys.stdout.write(f"{said}\n")


def test_it_stops_within_two_seconds_and_cleanly(touchd: Container) -> None:
    await_events(touchd, 3)
    before_s, after_s = touchd.run("date +%s.%N; systemctl stop touchd; date +%s.%N", 300).splitlines()
    assert float(after_s) - float(before_s) < 2.0
    assert shown(touchd, "Result", "ExecMainStatus") == ["success", "0"]


def test_an_upgrade_that_fails_leaves_the_old_program_running(touchd: Container) -> None:
    before = shown(touchd, "MainPID")
    assert not touchd.succeeds("cd /root/touchd && PIP_NO_INDEX=1 PIP_FIND_LINKS=/nowhere make install")
    assert shown(touchd, "MainPID", "ActiveState") == [*before, "active"]
    touchd.run("systemctl restart touchd", 900)
    assert touchd.run("ls /opt") == "touchd"


def test_an_upgrade_keeps_the_configuration_and_runs_the_new_program(touchd: Container) -> None:
    before = shown(touchd, "MainPID")
    touchd.run(INSTALL, 1800)
    touchd.wait_until("systemctl is-active -q touchd")
    assert shown(touchd, "MainPID") != before
    assert touchd.run("cat /etc/touchd/touchd.yaml") == CONFIGURATION.strip()


def test_uninstalling_keeps_configuration_and_journal(touchd: Container) -> None:
    await_events(touchd, 3)
    touchd.run("systemctl enable --quiet touchd")
    touchd.run("cd /root/touchd && make uninstall && make uninstall", 300)
    assert not touchd.succeeds("systemctl is-active -q touchd")
    assert touchd.run("ls /opt /etc/touchd").split() == ["/etc/touchd:", "touchd.yaml", "/opt:"]
    assert touchd.succeeds(f"test -s {EVENTS}")
    left = touchd.run("find /etc /usr/local -name '*touchd*' ! -path '/etc/touchd*' ! -path '*.service.d*'")
    assert left == ""
    touchd.run(INSTALL, 1800)
