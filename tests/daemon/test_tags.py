"""Tags: `run --tag` and `touchd tag` put them into every event, bounded and printable."""

import json
import os
import socket
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
from rigs.expectations import LENGTHS
from rigs.made_events import PREDICTION
from rigs.patient_port import PATIENT, playing
from rigs.running_daemon import SPEED
from rigs.wait import WITHIN_S, wait_for

from touchd.daemon.app import cli
from touchd.daemon.commands import tag as command
from touchd.daemon.path.events import Event, RobotEvent, encode
from touchd.daemon.sinks.sink import EventFanout
from touchd.daemon.sinks.tags import ADDRESS, TagError, TagServer, changed
from touchd.daemon.sinks.touches import decode

SERVE = """
import sys
from touchd.daemon.sinks.sink import EventFanout
from touchd.daemon.sinks.tags import TagServer
with TagServer(EventFanout()):
    print(1, flush=True)
    sys.stdin.read()
"""
# The first call loads every module, which the other user may not be able to read.
AS_ANOTHER_USER = """
import os
from contextlib import suppress
from touchd.daemon.commands.tag import main
from touchd.daemon.sinks.tags import TagError
with suppress(TagError):
    main(["--pid", "1"])
os.setuid(65534)
main(["--pid", "{pid}", "participant=P07"])
"""


class Listed:
    """A sink that keeps its events."""

    def __init__(self) -> None:
        self.events: list[Event] = []

    def start(self) -> None: ...

    def put(self, event: Event) -> None:
        self.events.append(event)

    def stop(self, timeout_s: float) -> None: ...


@contextmanager
def tagged() -> Iterator[tuple[EventFanout, Listed]]:
    """Serve tags of a fan-out to one sink, in this process."""
    fanout, sink = EventFanout(), Listed()
    fanout.sinks = (sink,)
    with TagServer(fanout):
        yield fanout, sink


def tag(*arguments: str) -> int:
    return cli.main(["tag", "--pid", str(os.getpid()), *arguments])


def test_tags_stand_in_every_event_from_then_on(capsys: pytest.CaptureFixture[str]) -> None:
    with tagged() as (fanout, sink):
        fanout.emit(PREDICTION)
        assert tag("participant=P07", "condition=fur=1") == 0
        fanout.emit(PREDICTION)
        assert tag("participant=", "condition=foil") == 0
        fanout.emit(RobotEvent(state="up", time=PREDICTION.time))
        assert tag() == 0
    assert [json.loads(encode(event)).get("tags") for event in sink.events] == [
        None,
        {"participant": "P07", "condition": "fur=1"},
        {"condition": "foil"},
    ]
    assert [decode(encode(event)) for event in sink.events] == sink.events
    assert capsys.readouterr().out.splitlines() == [
        "tags: participant=P07, condition=fur=1",
        "tags: condition=foil",
        "tags: condition=foil",
    ]


@pytest.mark.parametrize(
    "text",
    ["participant", "=P07", "1=2", "a b=c", "k" * 33 + "=v", "k=" + "v" * 65, "k=a\nb", "k=a/b", "k=\x1b[2J"],
)
def test_an_unusable_tag_changes_nothing(text: str, capsys: pytest.CaptureFixture[str]) -> None:
    with tagged() as (fanout, _):
        assert tag("participant=P07") == 0
        assert tag("condition=fur", text) == 2
        assert fanout.tags == {"participant": "P07"}
    assert len(capsys.readouterr().err.splitlines()) == 1


def test_there_are_eight_tags_at_most(capsys: pytest.CaptureFixture[str]) -> None:
    with tagged() as (fanout, _):
        assert tag(*(f"k{number}=v" for number in range(8))) == 0
        assert tag("k8=v") == 2
        assert tag("k0=", "k8=v") == 0
        assert len(fanout.tags) == 8
    with pytest.raises(TagError):
        changed({}, [f"k{number}=v" for number in range(9)])


def test_without_a_daemon_it_says_so_in_a_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(command, "NAMES", tmp_path / "names")
    (tmp_path / "names").touch()
    assert cli.main(["tag", "participant=P07"]) == 2
    assert "no touchd runs on this computer" in capsys.readouterr().err


def test_a_process_that_is_not_a_daemon_is_named(capsys: pytest.CaptureFixture[str]) -> None:
    assert tag("participant=P07") == 2
    assert f"process {os.getpid()} is not a running touchd" in capsys.readouterr().err


def test_of_two_daemons_one_has_to_be_chosen(capsys: pytest.CaptureFixture[str]) -> None:
    with (
        tagged() as (fanout, _),
        subprocess.Popen(
            [sys.executable, "-c", SERVE], stdin=subprocess.PIPE, stdout=subprocess.PIPE
        ) as other,
    ):
        assert other.stdout is not None
        other.stdout.readline()
        assert cli.main(["tag", "participant=P07"]) == 2
        assert f"{other.pid} (tags: none)" in capsys.readouterr().err
        assert tag("participant=P07") == 0
        assert fanout.tags == {"participant": "P07"}
        other.communicate()


def test_a_daemon_that_hangs_is_not_another_users(capsys: pytest.CaptureFixture[str]) -> None:
    with socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET) as hanging:
        hanging.bind(ADDRESS.format(pid=os.getpid()))
        hanging.listen()
        assert tag("participant=P07") == 2
    assert f"touchd, process {os.getpid()}, does not answer" in capsys.readouterr().err


@pytest.mark.skipif(os.geteuid() != 0, reason="only root can become another user")
def test_another_user_cannot_tag() -> None:
    with tagged() as (fanout, _):
        code = AS_ANOTHER_USER.format(pid=os.getpid())
        asked = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
        assert fanout.tags == {}
    assert "TagError: touchd runs as another user" in asked.stderr


def test_run_writes_its_tags_to_the_journal(tmp_path: Path) -> None:
    journal, config = tmp_path / "events.jsonl", tmp_path / "touchd.yaml"

    def ends() -> int:
        return journal.read_bytes().count(b"touch_ended") if journal.exists() else 0

    with playing(LENGTHS, SPEED, loop=True) as port:
        scene = f"scene: {{stale_s: {PATIENT.stale_s}}}"
        config.write_text(f"sensor: {{port: {port.path}}}\n{scene}\njournal: {{path: {journal}}}\n")
        program = [sys.executable, "-m", "touchd.daemon", "run"]
        command = [*program, "-c", str(config), "--tag", "participant=P07"]
        with subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL) as daemon:
            try:
                wait_for(ends)
                assert cli.main(["tag", "--pid", str(daemon.pid), "participant=P08"]) == 0
                count = ends()
                wait_for(lambda: ends() > count + 1)
            finally:
                daemon.terminate()
                daemon.wait(WITHIN_S)
    tags = [decode(line).tags for line in journal.read_bytes().splitlines()]
    assert tags[0] == {"participant": "P07"}
    assert tags[-1] == {"participant": "P08"}
    assert all(tags)
