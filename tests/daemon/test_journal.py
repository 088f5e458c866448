"""The journal: whole lines within its limits, whatever happens to the disk, the file and the program."""

import json
import os
import random
import shutil
import sys
import time
from collections.abc import Callable
from pathlib import Path

import pytest
from rigs.made_events import PREDICTION, touch
from rigs.programs import Program, ran
from rigs.small_disk import log_on_small_disk, needs_small_disk
from rigs.wait import WITHIN_S

from touchd.daemon.app import cli
from touchd.daemon.app.config import JournalSettings
from touchd.daemon.path.events import Label, TouchEnded, encode
from touchd.daemon.sinks.journal import Journal, JournalError, open_journal
from touchd.daemon.sinks.touches import decode, gather, read_events, read_labels


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "events.jsonl"


def numbers(path: Path) -> list[int]:
    """Return the numbers of the touches whose beginning a journal holds."""
    return [found.began.touch for found in gather(read_events(path)[0])]


def numbered(count: int) -> list[bytes]:
    return [b'{"type":"n","n": %d}' % number for number in range(count)]


def write(path: Path, lines: list[bytes], **limits: int) -> None:
    """Append lines to a journal; keeps one older file unless told otherwise."""
    journal = Journal(path, **({"max_bytes": 100, "keep": 1} | limits))
    for line in lines:
        journal.append(line)
    journal.close()


def test_stopping_writes_what_is_queued_and_may_be_repeated(path: Path) -> None:
    sink = Journal(path)
    sink.start()
    for number in range(200):
        sink.put(touch(number))
    sink.stop(WITHIN_S)
    sink.stop(WITHIN_S)
    assert [decode(line) for line in path.read_bytes().splitlines()] == [touch(n) for n in range(200)]


def test_the_journal_rotates_within_its_limits(path: Path) -> None:
    write(path, numbered(200), max_bytes=1000, keep=2)
    files = [*(path.with_name(f"events.jsonl.{number}") for number in (2, 1)), path]
    assert sorted(path.parent.iterdir()) == sorted(files)
    assert all(file.stat().st_size <= 1000 for file in files)
    lines = [line for file in files for line in file.read_bytes().splitlines()]
    assert lines == numbered(200)[-len(lines) :] != []


def test_a_journal_behind_a_link_rotates_beside_its_target(path: Path) -> None:
    (disk := path.with_name("disk")).mkdir()
    path.symlink_to(disk / "touches.jsonl")
    write(path, numbered(20))
    assert path.is_symlink()
    assert sorted(file.name for file in disk.iterdir()) == ["touches.jsonl", "touches.jsonl.1"]


def test_half_a_line_left_by_a_power_cut_is_removed(path: Path) -> None:
    path.write_bytes(b'{"type":"n","n": 0}\n{"type":"n","n": ')
    write(path, numbered(2)[1:])
    assert path.read_bytes().splitlines() == numbered(2)


NOT_OURS = "is not a journal of touchd; it was left as it is; give another journal.path"


@pytest.mark.parametrize(
    ("make", "why"),
    [
        (lambda path: path.write_bytes(b"%PDF-1.7\n" + os.urandom(50_000)), NOT_OURS),
        (lambda path: path.write_bytes(b'{"name": "settings"}'), NOT_OURS),
        (lambda path: path.write_bytes(b"\n"), NOT_OURS),
        (os.mkfifo, "is not a file"),
        (Path.mkdir, "is not a file"),
        (lambda path: path.symlink_to("/dev/null"), "is not a file"),
        (lambda path: path.symlink_to(path), r"cannot be written \(Too many levels of symbolic links\)"),
        (lambda path: path.symlink_to("nowhere/x"), r"cannot be written \(No such file or directory\)"),
    ],
)
def test_what_cannot_be_a_journal_is_refused_untouched(
    path: Path, make: Callable[[Path], object], why: str
) -> None:
    make(path)
    before = path.read_bytes() if why is NOT_OURS else None
    with pytest.raises(JournalError, match=rf"journal .*: {why}"):
        Journal(path)
    assert before is None or path.read_bytes() == before


def test_two_daemons_do_not_write_one_journal(path: Path) -> None:
    first = Journal(path, max_bytes=200, keep=1)
    for number in range(10):
        first.append(encode(touch(number)))
        # The lock also holds while the journal rotates.
        with pytest.raises(JournalError, match="another touchd writes it"):
            Journal(path, max_bytes=200, keep=1)
    first.close()
    Journal(path, max_bytes=200, keep=1).close()


@pytest.mark.parametrize("take_away", [Path.unlink, lambda path: path.rename(path.with_name("moved"))])
def test_a_removed_journal_is_recreated_and_reported(
    path: Path, take_away: Callable[[Path], object], caplog: pytest.LogCaptureFixture
) -> None:
    journal = Journal(path)
    journal.append(encode(touch(1)))
    take_away(path)
    journal.append(encode(touch(2)))
    journal.append(encode(touch(3)))
    journal.close()
    assert numbers(path) == [2, 3]
    assert caplog.text.count("was removed") == 1


def test_a_deleted_journal_folder_is_warned_of_once(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    (folder := tmp_path / "state").mkdir()
    journal = Journal(folder / "events.jsonl")
    shutil.rmtree(folder)
    for number in range(5):
        journal.append(encode(touch(number)))
    (warning,) = caplog.messages
    assert "No such file or directory; events cannot be saved" in warning
    folder.mkdir()
    journal.append(encode(touch(5)))
    journal.close()
    assert numbers(folder / "events.jsonl") == [5]


def test_the_default_path_is_in_the_state_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("STATE_DIRECTORY", "/var/lib/touchd")
    assert JournalSettings().file == Path("/var/lib/touchd/events.jsonl")
    monkeypatch.delenv("STATE_DIRECTORY")
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "state"))
    open_journal(JournalSettings()).close()
    assert (tmp_path / "state/touchd/events.jsonl").exists()
    monkeypatch.setenv("XDG_STATE_HOME", "/proc/state")
    with pytest.raises(JournalError, match=r"journal /proc/state/touchd/events.jsonl: .*; set journal: null"):
        open_journal(JournalSettings())


FILL_THE_DISK = """
import json, logging, resource, signal, sys
from pathlib import Path
from touchd.daemon.sinks.journal import Journal
logging.basicConfig(level=logging.INFO, format="%(levelname)s %(message)s")
signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
path = Path(sys.argv[1]) / "events.jsonl"
ballast = path.with_name("ballast")
ballast.write_bytes(bytes(16_384))
journal = Journal(path, max_bytes=10**9, keep=1)
resource.setrlimit(resource.RLIMIT_FSIZE, (100_000, resource.RLIM_INFINITY))
number = 0
while journal.lost < 500:
    journal.append(b'{"type":"n","n": %d}' % number)
    number += 1
full = [json.loads(line)["n"] for line in path.read_bytes().splitlines()]
ballast.unlink()
resource.setrlimit(resource.RLIMIT_FSIZE, (resource.RLIM_INFINITY, resource.RLIM_INFINITY))
journal.append(b'{"type":"n","n": -1}')
after = [json.loads(line)["n"] for line in path.read_bytes().splitlines()]
assert full == list(range(number - 500)), full[-5:]
assert after == [*full, -1], after[-5:]
"""


# A limit on file size is nearly a full disk.
@pytest.mark.parametrize("is_real", [False, pytest.param(True, marks=needs_small_disk)])
def test_a_full_disk_leaves_only_whole_lines(tmp_path: Path, is_real: bool) -> None:
    if is_real:
        log = log_on_small_disk(tmp_path, 64, FILL_THE_DISK)
    else:
        log = ran([sys.executable, "-c", FILL_THE_DISK, str(tmp_path)], check=True).stderr.splitlines()
    warning, recovery = log
    assert warning.startswith("WARNING")
    assert "No space left on device; events cannot be saved" in warning
    assert recovery.startswith("INFO")
    assert "works again; 500 events were lost" in recovery


KILL_MID_WRITE = """
import random, sys
from pathlib import Path
from touchd.daemon.sinks.journal import Journal
journal = Journal(Path(sys.argv[1]), max_bytes=100_000, keep=3)
print("writing", flush=True)
while True:
    journal.append(b'{"type":"n","n": "' + b"x" * random.randrange(1, 1000) + b'"}')
"""


@pytest.mark.parametrize("times", [1, pytest.param(50, marks=pytest.mark.slow)])
def test_a_kill_at_any_point_leaves_a_whole_journal(path: Path, times: int) -> None:
    chance = random.Random(1)
    for attempt in range(times):
        with Program(sys.executable, "-c", KILL_MID_WRITE, path) as process:
            process.stdout.readline()
            while attempt == 0 and not path.with_name("events.jsonl.1").exists():
                assert process.poll() is None
            time.sleep(chance.uniform(0.0, 0.1))
            process.kill()
        # Opening the journal cuts off a half-written line.
        Journal(path, max_bytes=100_000, keep=3).close()
        for file in path.parent.iterdir():
            written = file.read_bytes()
            assert written.endswith(b"\n") or not written
            assert all(json.loads(line)["n"] for line in written.splitlines())
    assert sum(file.stat().st_size for file in path.parent.iterdir()) <= 4 * 100_000


# A deeply nested line, invalid times, times and numbers too large for a file format, and undecodable bytes.
BAD_LINES = [
    b'{"type":"touch_began","touch":' + b"[" * 20_000 + b"]" * 20_000 + b"}",
    *(
        b'{"type":"touch_began","touch":1,"sensor_ms":1,"time":"%s"}' % time
        for time in (b"garbage", b"", b"1931-01-01T00:00:00.000Z", b"9999-01-01T00:00:00.000Z", b"2026-13-01")
    ),
    encode(PREDICTION).replace(b'"elapsed_s":1.0', b'"elapsed_s":1e308'),
    b'{"type":"touch_began","touch":' + b"9" * 400 + b',"sensor_ms":1,"time":"2026-11-20T10:00:00.000Z"}',
    b"\xff\xfe",
]


@pytest.mark.parametrize("suffix", ["csv", "mcap"])
def test_bad_lines_do_not_stop_a_journals_readers(path: Path, suffix: str) -> None:
    pytest.importorskip(suffix)
    ended = TouchEnded(touch=1, gesture="pat", frames=9, reason="released", time="2026-11-20T10:00:01.000Z")
    path.write_bytes(b"\n".join([encode(touch(1)), *BAD_LINES, encode(ended)]) + b"\n")
    out = path.with_name(f"out.{suffix}")
    assert cli.main(["convert", str(path), "-o", str(out)]) == 0
    assert out.stat().st_size > 100
    (found,) = gather(read_events(path)[0])
    assert found.ended == ended


def test_a_hole_in_the_numbers_hides_no_older_file(path: Path) -> None:
    for number, name in enumerate(("events.jsonl.5", "events.jsonl.2", "events.jsonl"), 1):
        label = Label(touch=number, began="", gesture="pat", time="2026-11-20T10:00:00.000Z")
        path.with_name(name).write_bytes(encode(label) + b"\n")
    assert [touch for _, touch in sorted(read_labels(path, "pad"))] == [1, 2, 3]
