"""Tags: `run --tag` and `touchd tag` put them into every event, bounded and printable."""

import json
import os
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory
from types import SimpleNamespace
from typing import Any

import pytest
from rigs.expectations import LENGTHS
from rigs.made_events import PREDICTION
from rigs.patient_port import PATIENT, playing
from rigs.running_daemon import SPEED
from rigs.wait import WITHIN_S, wait_for

from touchd.daemon.app import cli
from touchd.daemon.path.events import Event, RobotEvent, encode
from touchd.daemon.sinks import tags
from touchd.daemon.sinks.sink import EventFanout
from touchd.daemon.sinks.tags import serving_tags
from touchd.daemon.sinks.touches import decode

# The first call loads every module, which the other user may not be able to read.
AS_ANOTHER_USER = """
import os, sys
from contextlib import suppress
from touchd.daemon.app.cli import options_of
from touchd.daemon.commands import tag
from touchd.daemon.sinks import tags
tags.FOLDERS = (sys.argv[1],)
with suppress(tags.TagError):
    tag.main(options_of("tag", ["-c", "none"]))
os.setuid(65534)
tag.main(options_of("tag", ["participant=P07"]))
"""


@pytest.fixture(autouse=True)
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The only folder in which this computer's daemons have their files."""
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    monkeypatch.delenv("RUNTIME_DIRECTORY", raising=False)
    monkeypatch.setattr(tags, "FOLDERS", ())
    return tmp_path


@contextmanager
def tagged(config: str = "a.yaml") -> Iterator[tuple[EventFanout, list[Event]]]:
    """Serve tags of a fan-out in this process; yields it and the events that went through it."""
    fanout, events = EventFanout(), list[Event]()
    sink: Any = SimpleNamespace(put=events.append)
    fanout.sinks = (sink,)
    with serving_tags(fanout, {}, Path(config), [f"/dev/{config}"]):
        yield fanout, events


def tag(*arguments: str) -> int:
    return cli.main(["tag", *arguments])


def test_tags_stand_in_every_event_from_then_on(capsys: pytest.CaptureFixture[str]) -> None:
    with tagged() as (fanout, events):
        fanout.emit(PREDICTION)
        assert tag("participant=P07", "condition=fur=1") == 0
        fanout.emit(PREDICTION)
        assert tag("participant=", "condition=foil") == 0
        fanout.emit(RobotEvent(state="up", time=PREDICTION.time))
        assert tag() == 0
    assert [json.loads(encode(event)).get("tags") for event in events] == [
        None,
        {"participant": "P07", "condition": "fur=1"},
        {"condition": "foil"},
    ]
    assert [decode(encode(event)) for event in events] == events
    assert capsys.readouterr().out.splitlines() == [
        "tags: participant=P07, condition=fur=1",
        "tags: condition=foil",
        "tags: condition=foil",
    ]


@pytest.mark.parametrize(
    "texts",
    [
        *(["participant"], ["=P07"], ["1=2"], ["a b=c"], ["k" * 33 + "=v"], ["k=" + "v" * 65]),
        *(["k=a\nb"], ["k=a/b"], ["k=\x1b[2J"]),
        # Eight more; there are eight at most.
        [f"k{number}=v" for number in range(8)],
    ],
)
def test_an_unusable_tag_changes_nothing(texts: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    with tagged() as (fanout, _):
        assert tag("participant=P07") == 0
        assert tag("condition=fur", *texts) == 2
        assert fanout.tags() == {"participant": "P07"}
    assert len(capsys.readouterr().err.splitlines()) == 1


def test_a_missing_daemon_is_reported_in_one_line(capsys: pytest.CaptureFixture[str]) -> None:
    assert tag("participant=P07") == 2
    with tagged():
        assert tag("participant=P07", "-c", "b.yaml") == 2
    none, other = capsys.readouterr().err.splitlines()
    assert "no touchd of yours runs on this computer; start it" in none
    assert "no touchd with these settings runs" in other


def test_two_daemons_require_a_choice(capsys: pytest.CaptureFixture[str]) -> None:
    with tagged() as (fanout, _), tagged("b.yaml") as (other, _):
        assert tag("participant=P07") == 2
        said = capsys.readouterr().err
        assert "choose one with -c FILE: " in said
        for config in ("a.yaml", "b.yaml"):
            assert f"{Path(config).resolve()} (pad at /dev/{config})" in said
        assert tag("participant=P07", "-c", "a.yaml") == 0
        assert (fanout.tags(), other.tags()) == ({"participant": "P07"}, {})


def test_files_of_a_killed_daemon_are_replaced(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with tagged():
        left = {path: path.read_bytes() for path in folder.iterdir()}
    assert list(folder.iterdir()) == []
    for path, content in left.items():
        path.write_bytes(content)
        path.chmod(0o666)
    assert tag("participant=P07") == 2
    assert "no touchd of yours runs" in capsys.readouterr().err
    with tagged() as (fanout, _):
        (file,) = folder.glob("*.tags")
        assert file.stat().st_mode & 0o077 == 0
        assert tag("participant=P07") == 0
        assert fanout.tags() == {"participant": "P07"}


@pytest.mark.parametrize("content", [None, b"", b"[1]", b"\xff"])
def test_a_damaged_file_leaves_the_tags_as_they_are(folder: Path, content: bytes | None) -> None:
    with tagged() as (fanout, _):
        assert tag("participant=P07") == 0
        assert fanout.tags() == {"participant": "P07"}
        (file,) = folder.glob("*.tags")
        file.unlink()
        if content is not None:
            file.write_bytes(content)
        assert fanout.tags() == {"participant": "P07"}


def test_a_second_daemon_of_one_file_leaves_the_firsts_tags(caplog: pytest.LogCaptureFixture) -> None:
    with tagged() as (fanout, _):
        with tagged():
            assert "`touchd tag` will not work" in caplog.text
        assert tag("participant=P07") == 0
        assert fanout.tags() == {"participant": "P07"}


@pytest.mark.parametrize("session", ["", "/nowhere"])
def test_tags_also_work_without_a_login_session(monkeypatch: pytest.MonkeyPatch, session: str) -> None:
    monkeypatch.setenv("XDG_RUNTIME_DIR", session)
    with tagged() as (fanout, _):
        assert tag("participant=P07", "-c", "a.yaml") == 0
        assert fanout.tags() == {"participant": "P07"}


@pytest.mark.skipif(os.geteuid() != 0, reason="only root can become another user")
def test_another_user_cannot_tag(tmp_path: Path) -> None:
    with TemporaryDirectory() as shared, pytest.MonkeyPatch.context() as patch:
        patch.setenv("RUNTIME_DIRECTORY", shared)
        with tagged() as (fanout, _):
            os.chmod(shared, 0o755)
            asked = subprocess.run(
                [sys.executable, "-c", AS_ANOTHER_USER, shared], capture_output=True, text=True
            )
            assert fanout.tags() == {}
    assert "put sudo before the command" in asked.stderr


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
                assert tag("-c", str(config), "participant=P08") == 0
                count = ends()
                wait_for(lambda: ends() > count + 1)
            finally:
                daemon.terminate()
                daemon.wait(WITHIN_S)
    written = [decode(line).tags for line in journal.read_bytes().splitlines()]
    assert written[0] == {"participant": "P07"}
    assert written[-1] == {"participant": "P08"}
    assert all(written)
