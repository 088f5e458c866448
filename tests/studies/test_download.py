"""`data`: the published recordings in a folder, whole and checked, or one line that says why not."""

import contextlib
import io
import re
import threading
import zipfile
from collections.abc import Iterator
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

import numpy as np
import pytest
from rich.console import Console

from docs.studies.training.download import ARCHIVE_NAME, Contents, obtain, unpack
from docs.studies.training.haart import PUBLISHED_FRAMES, TEST_FILE
from docs.studies.training.http_file import DownloadError, fetch
from drivers.recording import RecordingError
from model.adapt.folder import HAART_TRAINING_FILE as TRAINING_FILE

EXPECTED = {TRAINING_FILE: Contents(2, ("P3", "P4")), TEST_FILE: Contents(1, ("T1",))}
CELLS = ",".join(f"cell{i}" for i in range(1, 65))


def published_csv(participants: tuple[str, ...], frames: int = PUBLISHED_FRAMES, gesture: str = "pat") -> str:
    """Made-up recordings in the layout of the official training file: quoted, space-padded header."""
    header = '"ParticipantNo", "Substrate", "Cover", "Gesture", ' + ", ".join(
        f'"{cell}"' for cell in CELLS.split(",")
    )
    rng = np.random.default_rng(0)
    rows = [
        f"{participant},foam,fur,{gesture}," + ",".join(map(str, rng.integers(1024, size=64)))
        for participant in participants
        for _ in range(frames)
    ]
    return "\n".join([header, *rows]) + "\n"


TRAINING_CSV = published_csv(("P3", "P4"))
TEST_CSV = published_csv(("T1",))


def archive(members: dict[str, str]) -> bytes:
    content = io.BytesIO()
    with zipfile.ZipFile(content, "w", zipfile.ZIP_DEFLATED) as opened:
        for name, text in members.items():
            opened.writestr(name, text)
    return content.getvalue()


GOOD = archive({"HAART DataSet/training.csv": TRAINING_CSV, "HAART DataSet/testWITHLABELS.csv": TEST_CSV})


class ArchiveServer(ThreadingHTTPServer):
    """Serves `content` on every path, as far as its switches let it; remembers the ranges asked for."""

    daemon_threads = True

    def __init__(self, content: bytes) -> None:
        super().__init__(("127.0.0.1", 0), ArchiveHandler)
        self.content = content
        self.honours_range = True
        self.says_length = True
        self.status = 200
        self.cut_after: int | None = None
        self.ranges: list[str | None] = []

    @property
    def url(self) -> str:
        return f"http://127.0.0.1:{self.server_address[1]}/HAART%20DataSet.zip"


class ArchiveHandler(BaseHTTPRequestHandler):
    """One answer of the server."""

    server: ArchiveServer

    def do_GET(self) -> None:
        asked = self.headers.get("Range")
        self.server.ranges.append(asked)
        if self.server.status != 200:
            self.send_error(self.server.status)
            return
        content = self.server.content
        first = 0
        if asked and self.server.honours_range:
            first = int(asked.removeprefix("bytes=").removesuffix("-"))
            if first >= len(content):
                self.send_error(416)
                return
            self.send_response(206)
            self.send_header("Content-Range", f"bytes {first}-{len(content) - 1}/{len(content)}")
        else:
            self.send_response(200)
        if self.server.says_length:
            self.send_header("Content-Length", str(len(content) - first))
        self.end_headers()
        self.wfile.write(content[first : self.server.cut_after])

    def log_message(self, format: str, *args: object) -> None:
        """Keep the tests' output clean."""


@contextlib.contextmanager
def serving(content: bytes) -> Iterator[ArchiveServer]:
    server = ArchiveServer(content)
    thread = threading.Thread(target=server.serve_forever, kwargs={"poll_interval": 0.01})
    thread.start()
    try:
        yield server
    finally:
        server.shutdown()
        thread.join()
        server.server_close()


@pytest.fixture
def server() -> Iterator[ArchiveServer]:
    with serving(GOOD) as running:
        yield running


def quiet() -> Console:
    return Console(file=io.StringIO())


def refusal(folder: Path, url: str) -> str:
    with pytest.raises(DownloadError) as raised:
        obtain(folder, quiet(), url, EXPECTED)
    assert "\n" not in str(raised.value)
    return str(raised.value)


def test_an_empty_folder_is_filled_and_checked(tmp_path: Path, server: ArchiveServer) -> None:
    folder = tmp_path / "new" / "haart"
    assert obtain(folder, quiet(), server.url, EXPECTED) == EXPECTED
    assert (folder / TRAINING_FILE).read_text() == TRAINING_CSV
    assert (folder / TEST_FILE).read_text() == TEST_CSV
    assert sorted(path.name for path in folder.iterdir()) == sorted([ARCHIVE_NAME, *EXPECTED])


def test_the_bar_shows_the_file_and_its_size(tmp_path: Path, server: ArchiveServer) -> None:
    shown = io.StringIO()
    obtain(tmp_path, Console(file=shown, force_terminal=True, width=100), server.url, EXPECTED)
    plain = re.sub(r"\x1b\[[0-9;?]*[A-Za-z]", "", shown.getvalue())
    assert ARCHIVE_NAME in plain
    assert f"{len(GOOD) / 1000:.1f}/{len(GOOD) / 1000:.1f} kB" in plain


def test_a_full_folder_is_checked_without_a_network(tmp_path: Path, server: ArchiveServer) -> None:
    obtain(tmp_path, quiet(), server.url, EXPECTED)
    assert obtain(tmp_path, quiet(), "http://127.0.0.1:9/", EXPECTED) == EXPECTED


def test_an_archive_fetched_by_hand_is_used(tmp_path: Path) -> None:
    (tmp_path / ARCHIVE_NAME).write_bytes(GOOD)
    assert obtain(tmp_path, quiet(), "http://127.0.0.1:9/", EXPECTED) == EXPECTED


def test_only_the_file_that_is_missing_is_put_in(tmp_path: Path, server: ArchiveServer) -> None:
    (tmp_path / TRAINING_FILE).write_text(TRAINING_CSV)
    before = (tmp_path / TRAINING_FILE).stat().st_ino
    obtain(tmp_path, quiet(), server.url, EXPECTED)
    assert (tmp_path / TRAINING_FILE).stat().st_ino == before
    assert (tmp_path / TEST_FILE).exists()


@pytest.mark.parametrize(
    ("text", "found"),
    [
        (published_csv(("P3",)), "1 recordings of P3, where the published file has 2 recordings of P3, P4"),
        (published_csv(("P3", "P5")), "2 recordings of P3, P5"),
        (published_csv(("P3", "P4"), frames=54), "54 frames of P3, foam, fur, pat, not 432"),
        (published_csv(("P3", "P4"), gesture="poke"), "not one of the gestures constant, notouch, pat"),
    ],
)
def test_a_folder_with_other_recordings_is_refused(tmp_path: Path, text: str, found: str) -> None:
    (tmp_path / TRAINING_FILE).write_text(text)
    with pytest.raises(RecordingError) as raised:
        obtain(tmp_path, quiet(), "http://127.0.0.1:9/", EXPECTED)
    assert found in str(raised.value)
    assert str(raised.value).startswith(f"{tmp_path / TRAINING_FILE}: ")


def test_an_interrupted_download_goes_on_where_it_stopped(tmp_path: Path, server: ArchiveServer) -> None:
    server.cut_after = len(GOOD) // 3
    message = refusal(tmp_path, server.url)
    assert f"ended after {len(GOOD) // 3:,} of {len(GOOD):,} bytes; run this again to go on" in message
    server.cut_after = None
    assert obtain(tmp_path, quiet(), server.url, EXPECTED) == EXPECTED
    assert server.ranges == [None, f"bytes={len(GOOD) // 3}-"]


def test_a_server_without_ranges_sends_it_all_again(tmp_path: Path, server: ArchiveServer) -> None:
    (tmp_path / f"{ARCHIVE_NAME}.part").write_bytes(GOOD[:100])
    server.honours_range = False
    assert obtain(tmp_path, quiet(), server.url, EXPECTED) == EXPECTED
    assert (tmp_path / ARCHIVE_NAME).read_bytes() == GOOD


def test_a_part_longer_than_the_file_is_begun_anew(tmp_path: Path, server: ArchiveServer) -> None:
    (tmp_path / f"{ARCHIVE_NAME}.part").write_bytes(bytes(len(GOOD) + 5))
    assert obtain(tmp_path, quiet(), server.url, EXPECTED) == EXPECTED


def test_a_server_that_says_no_length_is_believed(tmp_path: Path, server: ArchiveServer) -> None:
    server.says_length = False
    assert obtain(tmp_path, quiet(), server.url, EXPECTED) == EXPECTED


def test_a_missing_page_is_named(tmp_path: Path, server: ArchiveServer) -> None:
    server.status = 404
    assert (
        refusal(tmp_path, server.url) == f"{server.url}: the server answers 404 Not Found; check the address"
    )


def test_a_refused_connection_is_named(tmp_path: Path) -> None:
    with serving(GOOD) as server:
        url = server.url
    assert "Connection refused); check the network and run this again" in refusal(tmp_path, url)


def test_a_silent_server_is_given_up(tmp_path: Path) -> None:
    with ThreadingHTTPServer(("127.0.0.1", 0), ArchiveHandler) as listening:
        url = f"http://127.0.0.1:{listening.server_address[1]}/"
        with pytest.raises(DownloadError, match=r"the connection failed \(timed out\)"):
            fetch(url, tmp_path / "archive", 10_000, lambda *_: None, timeout_s=0.05)


@pytest.mark.parametrize("url", ["file:///etc/passwd", "ftp://host/archive.zip", "archive.zip"])
def test_only_web_addresses_are_fetched(tmp_path: Path, url: str) -> None:
    assert refusal(tmp_path, url) == f"{url}: not an http or https address"


@pytest.mark.parametrize("says_length", [True, False])
def test_a_file_that_is_too_large_is_not_fetched(
    tmp_path: Path, server: ArchiveServer, says_length: bool
) -> None:
    server.says_length = says_length
    with pytest.raises(DownloadError, match="larger than 1,000 bytes; that is not the expected file"):
        fetch(server.url, tmp_path / "archive", 1000, lambda *_: None)
    part = tmp_path / "archive.part"
    assert not part.exists() or part.stat().st_size <= 1000


def test_a_full_disk_is_named(tmp_path: Path, server: ArchiveServer) -> None:
    (tmp_path / f"{ARCHIVE_NAME}.part").symlink_to("/dev/full")
    message = refusal(tmp_path, server.url)
    assert message.endswith("cannot be written (No space left on device); make room, then run this again")


def test_a_file_where_the_folder_should_be_is_named(tmp_path: Path, server: ArchiveServer) -> None:
    (tmp_path / "haart").write_text("")
    assert "choose another folder" in refusal(tmp_path / "haart", server.url)


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"<html>moved</html>", r"damaged \(File is not a zip file\); delete it and run this again"),
        (GOOD[: len(GOOD) // 2], r"damaged \(File is not a zip file\)"),
        (GOOD[:5000] + b"\0" * 5000 + GOOD[10_000:], "damaged"),
        (archive({"training.csv": TRAINING_CSV}), r"holds 0 files testWITHLABELS\.csv, not one"),
        (
            archive({"a/training.csv": TRAINING_CSV, "b/training.csv": "", "testWITHLABELS.csv": TEST_CSV}),
            r"holds 2 files training\.csv, not one",
        ),
        (
            archive({"training.csv": TEST_CSV, "testWITHLABELS.csv": TEST_CSV}),
            r"not the published set \(training\.csv: 1 recordings of T1, where",
        ),
        (
            archive({"training.csv": "a,b\n1,2\n", "testWITHLABELS.csv": TEST_CSV}),
            r"not the published set \(training\.csv: no known layout",
        ),
    ],
)
def test_a_foreign_archive_leaves_the_folder_unchanged(tmp_path: Path, content: bytes, message: str) -> None:
    (tmp_path / ARCHIVE_NAME).write_bytes(content)
    with pytest.raises(DownloadError, match=message) as raised:
        obtain(tmp_path, quiet(), "http://127.0.0.1:9/", EXPECTED)
    assert "\n" not in str(raised.value)
    assert [path.name for path in tmp_path.iterdir()] == [ARCHIVE_NAME]


def test_a_zip_bomb_is_refused_unpacked(tmp_path: Path) -> None:
    bomb = tmp_path / ARCHIVE_NAME
    bomb.write_bytes(archive({"training.csv": "0" * 1_000_000, "testWITHLABELS.csv": TEST_CSV}))
    assert bomb.stat().st_size < 200_000
    with pytest.raises(DownloadError, match=r"training\.csv would unpack to 1,000,000 bytes; refused"):
        unpack(bomb, tmp_path, EXPECTED, max_bytes=900_000)


def test_a_lying_zip_bomb_is_cut_off(tmp_path: Path) -> None:
    honest = archive({"training.csv": "0" * 1_000_000, "testWITHLABELS.csv": TEST_CSV})
    lie = honest.replace((1_000_000).to_bytes(4, "little"), (1000).to_bytes(4, "little"))
    (tmp_path / ARCHIVE_NAME).write_bytes(lie)
    with pytest.raises(DownloadError, match="damaged"):
        unpack(tmp_path / ARCHIVE_NAME, tmp_path, EXPECTED, max_bytes=900_000)
    assert [path.name for path in tmp_path.iterdir()] == [ARCHIVE_NAME]


def test_only_the_two_files_are_unpacked(tmp_path: Path) -> None:
    folder = tmp_path / "outer" / "haart"
    folder.mkdir(parents=True)
    members = {
        "../../training.csv": TRAINING_CSV,
        "/tmp/testWITHLABELS.csv": TEST_CSV,
        "../evil.csv": "evil",
        "readme.txt": "evil",
    }
    (folder / ARCHIVE_NAME).write_bytes(archive(members))
    obtain(folder, quiet(), "http://127.0.0.1:9/", EXPECTED)
    files = [path for path in tmp_path.rglob("*") if path.is_file()]
    assert sorted(files) == sorted([folder / ARCHIVE_NAME, folder / TRAINING_FILE, folder / TEST_FILE])
