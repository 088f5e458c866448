"""Recordings: every layout is read and written back whole, realigned, and joined into streams."""

import errno
import gzip
import hashlib
import os
import shutil
import threading
from collections.abc import Sequence
from contextlib import nullcontext
from dataclasses import fields, replace
from pathlib import Path

import numpy as np
import pytest
from rigs.haart_folder import needs_haart

from touchd.drivers import recording as recording_module
from touchd.drivers.recording import (
    Recording,
    RecordingError,
    ideal_clock_ms,
    read_recordings,
    realign,
    splice,
    write_recordings,
)
from touchd.drivers.whole_file import open_nonblocking, whole_file

CELL_NAMES = [f"cell{i}" for i in range(1, 65)]
CONDITION = ["Substrate", "Cover", "Gesture"]
TRAINING_HEADER = ", ".join(f'"{name}"' for name in ["ParticipantNo", *CONDITION, *CELL_NAMES])
TEST_HEADER = ",".join(["ParticipantID", *CONDITION, "Sequence", *CELL_NAMES])
ROW = "P3,foam,fur,rub,1,"


def made(participant: str, gesture: str, frames: int = 5, first_ms: int = 40) -> Recording:
    counts = np.random.default_rng(frames).integers(0, 1024, (frames, 8, 8)).astype(np.uint16)
    return Recording(participant, "foam", "fur", gesture, counts, ideal_clock_ms(frames, first_ms), "live")


@pytest.fixture
def pad(tmp_path: Path) -> Path:
    """Where a test writes a recording."""
    return tmp_path / "pad.csv"


def cells(first: int) -> str:
    return ",".join(str((first + i) % 1024) for i in range(64))


def assert_same(read: Sequence[Recording], written: Sequence[Recording]) -> None:
    for one, other in zip(read, written, strict=True):
        for field in fields(Recording):
            np.testing.assert_array_equal(getattr(one, field.name), getattr(other, field.name))


@pytest.mark.parametrize("name", ["pad.csv", "pad.csv.gz"])
def test_written_recordings_read_back_with_their_provenance(tmp_path: Path, name: str) -> None:
    path = tmp_path / name
    recordings = [made("P1", "rub"), made("P1", "pat", 7), made("P2", "pat", 3)]
    write_recordings(path, recordings, {"source": "made up\nfor a test", "licence": "none"})
    assert_same(read_recordings(path), recordings)
    wanted = {"participant": ["P1"], "gesture": ["pat", "stroke"]}
    assert_same(read_recordings(path, wanted), [recordings[1]])
    written = path.read_bytes()
    text = (gzip.decompress(written) if name.endswith(".gz") else written).decode()
    assert text.splitlines()[:2] == ["# source: made up for a test", "# licence: none"]


def test_a_file_is_private_and_never_written_over(pad: Path) -> None:
    with pytest.raises(RecordingError, match="two in a row share"):
        write_recordings(pad, [made("P1", "rub"), made("P1", "rub", 7)], {})
    write_recordings(pad, [made("P1", "rub")], {})
    # Recordings are of people.
    assert pad.stat().st_mode & 0o007 == 0
    with pytest.raises(RecordingError, match=r"pad\.csv: is there already, and is never written over"):
        write_recordings(pad, [made("P2", "rub")], {})
    assert_same(read_recordings(pad), [made("P1", "rub")])
    assert list(pad.parent.iterdir()) == [pad]


@pytest.mark.parametrize(
    ("header", "rows"),
    [
        (TRAINING_HEADER, ["P3,foam,fur,rub,", "P3,foam,fur,rub,", "P3,foam,fur,pat,"]),
        (TRAINING_HEADER.replace('"', ""), ['"P3", "foam", "fur", "rub", '] * 2 + ["P3,foam,fur,pat,"]),
        (TEST_HEADER, ["P3,foam,fur,rub,1,", "P3,foam,fur,rub,2,", "P3,foam,fur,pat,1,"]),
    ],
    ids=["training", "training without quotes", "test with its extra column"],
)
def test_each_of_haarts_layouts_gives_all_64_cells(pad: Path, header: str, rows: list[str]) -> None:
    pad.write_text("\n".join([header, *(row + cells(number) for number, row in enumerate(rows)), ""]))
    rub, pat = read_recordings(pad)
    assert (rub.gesture, len(rub.counts), pat.gesture, len(pat.counts)) == ("rub", 2, "pat", 1)
    np.testing.assert_array_equal(rub.counts[1].ravel(), np.arange(1, 65))
    assert rub.framing == "published"
    assert rub.sensor_ms.tolist() == [0, 19]
    assert len(realign(rub).counts) == 1
    with pytest.raises(RecordingError, match="P3, pat: one row is no whole scan"):
        realign(pat)


@pytest.mark.parametrize(
    ("old", "new"),
    [("", ""), (",", ";"), ("\n", "\r\n"), (",", "\t"), ("# source: made for a test", '"# a, b"')],
    ids=["comma", "semicolon", "CRLF", "tab", "quoted comment"],
)
def test_a_file_that_a_spreadsheet_saved_is_read(pad: Path, old: str, new: str) -> None:
    recordings = [made("Ännchen", "rub", 50)]
    write_recordings(pad, recordings, {"source": "made for a test"})
    text = pad.read_text(encoding="utf-8").replace(old, new)
    pad.write_bytes(text.encode("utf-8-sig"))
    assert_same(read_recordings(pad), recordings)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "holds no rows"),
        ("a,b,c\n1,2,3\n", "no known layout"),
        ("participant,substrate,cover,gesture,cell1,cell2\n1,a,b,pat,3,4\n", "no known layout"),
        (f"{TEST_HEADER},more\n", "no known layout .*no more"),
        (f"{TEST_HEADER}\n{ROW}{cells(0)}\nP3,foam\n", "line 3: 2 columns where the header has 69"),
        (f"{TEST_HEADER}\n{ROW}{cells(960)[:-4]}1024\n", "line 2: a count outside 0 to 1023"),
        (f"# a note\n{TEST_HEADER}\n{ROW}-{cells(1)}\n", "line 3: a count outside 0 to 1023"),
        (f"{TEST_HEADER}\n{ROW}x{cells(1)}\n", "line 2: invalid literal, no whole number: 'x1'"),
        (f"{TEST_HEADER}\n{ROW}{'0' * 5000}\n", "line 2: too long"),
        (TEST_HEADER.encode("utf-16"), "no UTF-8 text; is it compressed, or saved in another encoding"),
    ],
)
def test_a_file_that_is_not_a_recording_names_its_line(pad: Path, text: str | bytes, message: str) -> None:
    pad.write_bytes(text.encode() if isinstance(text, str) else text)
    with pytest.raises(RecordingError, match=f"pad.csv.*{message}"):
        read_recordings(pad)


def test_a_missing_or_damaged_archive_is_refused_by_name(tmp_path: Path) -> None:
    path = tmp_path / "pad.csv.gz"
    with pytest.raises(RecordingError, match=r"pad\.csv\.gz: cannot be read"):
        read_recordings(path)
    write_recordings(path, [made("P1", "rub", 50)], {})
    written = path.read_bytes()
    # A reserved block type of deflate (RFC 1951), right after the archive's header and name.
    garbled = written[: written.index(b"\0", 10) + 1] + b"\x07" + written[30:]
    for damaged in (written[:-100], garbled):
        path.write_bytes(damaged)
        with pytest.raises(RecordingError, match=r"pad\.csv\.gz: cannot be read as a recording"):
            read_recordings(path)


def test_a_file_with_too_many_lines_is_refused(pad: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(recording_module, "MOST_LINES", 4)
    write_recordings(pad, [made("P1", "rub", 3)], {})
    assert len(read_recordings(pad)) == 1
    with pad.open("a") as file:
        file.write(f"P1,foam,fur,rub,99,{cells(0)}\n")
    with pytest.raises(RecordingError, match="more than 4 lines"):
        read_recordings(pad)


def test_realigning_joins_the_two_halves_of_each_scan() -> None:
    scans = np.arange(6 * 64, dtype=np.uint16).reshape(6, 8, 8)
    published = np.roll(scans.reshape(-1, 8), 2, axis=0).reshape(6, 8, 8)[:5]
    recording = Recording("P3", "foam", "fur", "rub", published, ideal_clock_ms(5), "published")
    live = realign(recording)
    np.testing.assert_array_equal(live.counts, scans[:4])
    assert (live.framing, len(live.sensor_ms)) == ("live", 4)
    assert realign(live) is live


def test_a_spliced_streams_clock_restarts_for_another_pad() -> None:
    stream = splice([made("P1", "notouch", 5), made("P1", "rub", 3, first_ms=900), made("P2", "rub", 3)])
    assert stream.counts.shape == (11, 8, 8)
    assert [(span.start, span.stop, span.gesture) for span in stream.spans] == [
        (0, 5, "notouch"),
        (5, 8, "rub"),
        (8, 11, "rub"),
    ]
    assert stream.sensor_ms.tolist() == [0, 19, 37, 56, 74, 93, 112, 130, 0, 19, 37]
    with pytest.raises(RecordingError, match="none matches"):
        splice([])


@needs_haart
@pytest.mark.slow
def test_haarts_files_are_read_completely() -> None:
    recordings = read_recordings(Path(os.environ["TOUCHD_HAART"]) / "testWITHLABELS.csv.gz")
    assert {recording.counts.shape for recording in recordings} == {(432, 8, 8)}
    digest = hashlib.sha256()
    for recording in recordings:
        digest.update(recording.counts.astype("<i2").tobytes())
    assert len(recordings) == 251
    assert (digest.hexdigest()[:8], digest.hexdigest()[-10:]) == ("a3cff346", "42fb04fb40")


@pytest.fixture
def before(tmp_path: Path) -> Path:
    """A file to rewrite."""
    path = tmp_path / "touchd.yaml"
    path.write_text("before")
    return path


@pytest.mark.parametrize("may_write", [None, True, False], ids=["own", "another's", "read-only"])
def test_a_replaced_file_keeps_its_owner_and_permissions(
    before: Path, monkeypatch: pytest.MonkeyPatch, may_write: bool | None
) -> None:
    groups: list[int] = []

    def chown(path: Path, user: int, group: int) -> None:
        if user != -1:
            raise PermissionError(errno.EPERM, os.strerror(errno.EPERM))
        groups.append(group)

    before.chmod(0o640)
    if may_write is not None:
        monkeypatch.setattr(os, "chown", chown)
        monkeypatch.setattr(os, "access", lambda *_: may_write)
    is_refused = may_write is False
    with pytest.raises(PermissionError) if is_refused else nullcontext(), whole_file(before) as partial:
        partial.write_text("after")
    assert before.read_text() == ("before" if is_refused else "after")
    assert before.stat().st_mode & 0o777 == 0o640
    assert groups == ([before.stat().st_gid] if may_write else [])


def test_a_file_is_synced_before_it_gets_its_name(before: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    synced: list[tuple[bytes, str]] = []
    monkeypatch.setattr(os, "fsync", lambda file: synced.append((os.pread(file, 99, 0), before.read_text())))
    # As a program that was killed leaves it.
    before.with_name(f".partial-{before.name}").write_bytes(b"half")
    with whole_file(before) as partial:
        partial.write_text("after")
    assert synced == [(b"after", "before")]
    assert (before.read_text(), list(before.parent.iterdir())) == ("after", [before])


@pytest.mark.parametrize("number", [errno.EPERM, errno.EOPNOTSUPP, errno.ENOSYS])
def test_a_new_file_is_written_without_hard_links(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, number: int
) -> None:
    def refuse(*_: object) -> None:
        raise OSError(number, os.strerror(number))

    monkeypatch.setattr(os, "link", refuse)
    path = tmp_path / "new"
    with whole_file(path, replace=False) as partial:
        partial.write_text("ours")
    with pytest.raises(FileExistsError), whole_file(path, replace=False) as partial:
        partial.write_text("other")
    assert path.read_text() == "ours"
    assert list(tmp_path.iterdir()) == [path]


def test_a_pipe_is_read_until_its_writer_closes_it(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe")
    writer = os.fdopen(os.open(tmp_path / "pipe", os.O_RDWR), "wb")
    with open(tmp_path / "pipe", "rb", opener=open_nonblocking) as pipe:
        late = threading.Timer(0.05, lambda: (writer.write(b"late"), writer.close()))
        late.start()
        assert pipe.read() == b"late"
        late.join()


def test_an_error_while_writing_leaves_the_old_file_alone(before: Path) -> None:
    with pytest.raises(FileNotFoundError), whole_file(before) as partial:
        shutil.copytree(before.with_name("not there"), partial)
    assert before.read_text() == "before"
    assert list(before.parent.iterdir()) == [before]


@pytest.mark.parametrize("step", [18_500, 0, -18])
def test_a_clock_not_in_milliseconds_is_refused(pad: Path, step: int) -> None:
    clock_ms = 10**6 + step * np.arange(20, dtype=np.int64)
    write_recordings(pad, [replace(made("P1", "rub", 20), sensor_ms=clock_ms)], {})
    with pytest.raises(RecordingError, match=f"changes by {step} a frame; it must rise by milliseconds"):
        read_recordings(pad)
