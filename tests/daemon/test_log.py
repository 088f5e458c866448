"""What reaches the log and the terminal from outside: printable, one line each, and not too often."""

import logging
import os
import subprocess

import pytest
from rigs.made_events import record
from rigs.programs import TOUCHD
from rigs.wait import WITHIN_S

from touchd.daemon.app.cli import main
from touchd.daemon.app.log import MOST_LINES, LogGate, LogHandler, LogLines
from touchd.daemon.sinks.sink import LinesSink
from touchd.drivers.errors import MAX_LINE_BYTES, one_line

HOSTILE = "one\nERROR root: forged\r\x1b]0;title\x07\x1b[2J\u202egnp.exe\x00\ud800\x9b31m"


def written(reader: int, writer: int, *records: logging.LogRecord) -> list[str]:
    """Write records to a pipe as the daemon's log does; return the lines that come out."""
    lines = LogLines(writer)
    handler = LogHandler(lines.put)
    for each in records:
        handler.handle(each)
    lines.start()
    lines.stop(WITHIN_S)
    os.close(writer)
    with open(reader, encoding="utf-8") as file:
        return file.read().removesuffix("\n").split("\n")


def test_foreign_text_is_printable_and_short() -> None:
    said = one_line(HOSTILE * 1000)
    assert said.isprintable()
    assert said.startswith(r"one\nERROR root: forged\r\x1b]0;title\x07\x1b[2J\u202egnp.exe\x00\ud800\x9b31m")
    assert len(said.encode()) <= MAX_LINE_BYTES
    assert one_line("grün: 触れる ✓") == "grün: 触れる ✓"


def test_every_written_line_has_passed_the_filter() -> None:
    lines = written(*os.pipe(), *(record("closed: %s", HOSTILE) for _ in range(MOST_LINES + 1)))
    assert len(lines) == MOST_LINES
    assert all(line.startswith("WARNING library: closed: one") and line.isprintable() for line in lines)


def test_systemds_journal_gets_the_level_of_each_line(monkeypatch: pytest.MonkeyPatch) -> None:
    reader, writer = os.pipe()
    status = os.fstat(writer)
    monkeypatch.setenv("JOURNAL_STREAM", f"{status.st_dev}:{status.st_ino}")
    failed = record("failed", line=2, level=logging.ERROR)
    failed.exc_info = (OSError, OSError("gone"), None)
    lines = written(reader, writer, record("ready", level=logging.INFO), failed)
    assert lines == ["<6>INFO library: ready", "<3>ERROR library: failed", "<3>  OSError: gone"]


def test_a_command_that_fails_under_systemd_says_its_level() -> None:
    reader, writer = os.pipe()
    status = os.fstat(writer)
    stream = {"JOURNAL_STREAM": f"{status.st_dev}:{status.st_ino}"}
    subprocess.run(
        [*TOUCHD, "run", "-c", "nowhere"], env={**os.environ, **stream}, stderr=writer, check=False
    )
    os.close(writer)
    with open(reader, encoding="utf-8") as file:
        assert file.read().startswith("<3>touchd: nowhere: cannot be read")


@pytest.mark.parametrize(
    "words", [[HOSTILE], ["run", "-c", f"/nowhere/{HOSTILE}"], ["run", "--live", HOSTILE]]
)
def test_the_command_line_shows_no_control_characters(
    words: list[str], capfd: pytest.CaptureFixture[str]
) -> None:
    assert main([word.replace("\0", "").replace("\ud800", "") for word in words]) == 2
    said = capfd.readouterr().err
    assert said.removesuffix("\n").isprintable()


def test_a_trace_cannot_forge_a_log_line() -> None:
    try:
        raise ValueError(HOSTILE)
    except ValueError as error:
        failed = record("failed")
        failed.exc_info = (ValueError, error, error.__traceback__)
    assert LogGate().filter(failed)
    first, *others = logging.Formatter("%(message)s").format(failed).split("\n")
    assert first == "failed"
    assert all(line.startswith("  ") and line.isprintable() for line in others)
    assert "ValueError" in others[-2]


def test_only_the_first_record_of_a_place_has_its_trace() -> None:
    gate = LogGate()
    records = [record("failed") for _ in range(3)]
    for each in records:
        each.exc_info = (OSError, OSError(HOSTILE), None)
        assert gate.filter(each)
    assert [each.exc_text is None for each in records] == [False, True, True]


def test_one_place_cannot_flood_the_log(monkeypatch: pytest.MonkeyPatch) -> None:
    now_s = 100.0
    monkeypatch.setattr("touchd.daemon.app.log.time.monotonic", lambda: now_s)
    gate = LogGate()
    records = [record("too many open files") for _ in range(43_000)]
    passed = [each.getMessage() for each in records if gate.filter(each)]
    left_out = "too many open files (more like it are left out for 60 s)"
    assert passed == [*["too many open files"] * (MOST_LINES - 1), left_out]
    assert gate.filter(record("another place", line=2))
    now_s += 61.0
    assert gate.filter(record("too many open files"))


def test_debugging_is_not_limited() -> None:
    gate = LogGate()
    assert all(gate.filter(record("detail", level=logging.DEBUG)) for _ in range(10 * MOST_LINES))


def test_lines_of_the_log_that_nobody_read_are_counted(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(LinesSink, "capacity", 3)
    lines = written(*os.pipe(), *(record(f"line {number}", line=number) for number in range(10)))
    gap = "7 lines of the log were dropped: nobody read them"
    assert [line.partition(": ")[2] for line in lines] == [gap, "line 7", "line 8", "line 9"]
