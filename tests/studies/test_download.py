"""`data`: fetches and checks the published recordings, or says in one line why not."""

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

from touchd.drivers.recording import RecordingError
from touchd.model.training.download import ARCHIVE_NAME, Contents, DownloadError, obtain, unpack
from touchd.model.training.haart import PUBLISHED_FRAMES, TEST_FILE, TRAINING_FILE

EXPECTED = {TRAINING_FILE: Contents(2, ("P3", "P4")), TEST_FILE: Contents(1, ("T1",))}


def published_csv(participants: tuple[str, ...], frames: int = PUBLISHED_FRAMES, gesture: str = "pat") -> str:
    """Made-up recordings in the layout of the official training file: quoted, space-padded header."""
    cells = ", ".join(f'"cell{i}"' for i in range(1, 65))
    header = f'"ParticipantNo", "Substrate", "Cover", "Gesture", {cells}'
    counts = np.random.default_rng(0).integers(1024, size=(len(participants), frames, 64)).tolist()
    rows = [
        f"{participant},foam,fur,{gesture}," + ",".join(map(str, frame))
        for participant, own in zip(participants, counts, strict=True)
        for frame in own
    ]
    return "\n".join([header, *rows]) + "\n"


NOWHERE = "http://127.0.0.1:9/"
TRAINING_CSV = published_csv(("P3", "P4"))
TEST_CSV = published_csv(("T1",))


def archive(members: dict[str, str]) -> bytes:
    content = io.BytesIO()
    with zipfile.ZipFile(content, "w", zipfile.ZIP_DEFLATED, compresslevel=1) as opened:
        for name, text in members.items():
            opened.writestr(name, text)
    return content.getvalue()


GOOD = archive({"HAART DataSet/training.csv": TRAINING_CSV, "HAART DataSet/testWITHLABELS.csv": TEST_CSV})


class ArchiveHandler(BaseHTTPRequestHandler):
    """Serves GOOD at /whole.zip, half of it at /cut.zip, nothing elsewhere."""

    def do_GET(self) -> None:
        if self.path not in ("/whole.zip", "/cut.zip"):
            self.send_error(404)
            return
        self.send_response(200)
        self.send_header("Content-Length", str(len(GOOD)))
        self.end_headers()
        self.wfile.write(GOOD if self.path == "/whole.zip" else GOOD[: len(GOOD) // 2])

    def log_message(self, format: str, *args: object) -> None:
        """Keep the tests' output clean."""


@pytest.fixture(scope="module")
def address() -> Iterator[str]:
    with ThreadingHTTPServer(("127.0.0.1", 0), ArchiveHandler) as server:
        threading.Thread(target=server.serve_forever, kwargs={"poll_interval": 0.01}).start()
        yield f"http://127.0.0.1:{server.server_address[1]}"
        server.shutdown()


def quiet() -> Console:
    return Console(file=io.StringIO())


def refusal(folder: Path, url: str) -> str:
    with pytest.raises(DownloadError) as raised:
        obtain(folder, quiet(), url, EXPECTED)
    assert "\n" not in str(raised.value)
    return str(raised.value)


def test_an_empty_folder_is_filled_and_checked(tmp_path: Path, address: str) -> None:
    folder = tmp_path / "new" / "haart"
    shown = io.StringIO()
    assert obtain(folder, Console(file=shown), f"{address}/whole.zip", EXPECTED) == EXPECTED
    assert (folder / TRAINING_FILE).read_text() == TRAINING_CSV
    assert (folder / TEST_FILE).read_text() == TEST_CSV
    assert sorted(path.name for path in folder.iterdir()) == sorted([ARCHIVE_NAME, *EXPECTED])
    assert ARCHIVE_NAME in shown.getvalue()


@pytest.mark.parametrize(
    "there",
    [
        {TRAINING_FILE: TRAINING_CSV.encode(), TEST_FILE: TEST_CSV.encode()},
        {TRAINING_FILE: TRAINING_CSV.encode(), ARCHIVE_NAME: GOOD},
    ],
    ids=["both files", "one file and the archive"],
)
def test_existing_files_are_used_without_a_network(tmp_path: Path, there: dict[str, bytes]) -> None:
    for name, content in there.items():
        (tmp_path / name).write_bytes(content)
    before = (tmp_path / TRAINING_FILE).stat().st_ino
    assert obtain(tmp_path, quiet(), NOWHERE, EXPECTED) == EXPECTED
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
        obtain(tmp_path, quiet(), NOWHERE, EXPECTED)
    assert found in str(raised.value)
    assert str(raised.value).startswith(f"{tmp_path / TRAINING_FILE}: ")


@pytest.mark.parametrize(
    ("page", "why"),
    [
        ("/cut.zip", rf"the connection ended {len(GOOD) - len(GOOD) // 2:,} bytes too early"),
        ("/other.zip", "HTTP Error 404: Not Found"),
        (None, "<urlopen error [Errno 111] Connection refused>"),
    ],
)
def test_a_download_that_fails_leaves_no_archive(
    tmp_path: Path, address: str, page: str | None, why: str
) -> None:
    url = f"{address}{page}" if page else NOWHERE
    message = refusal(tmp_path, url)
    assert message.startswith(f"{url}: cannot be fetched ({why}); run this again, or put the archive there: ")
    assert not (tmp_path / ARCHIVE_NAME).exists()


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"<html>moved</html>", r"damaged \(File is not a zip file\); delete it and run this again"),
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
    assert re.search(message, refusal(tmp_path, NOWHERE))
    assert [path.name for path in tmp_path.iterdir()] == [ARCHIVE_NAME]


def test_a_zip_bomb_is_refused_unpacked(tmp_path: Path) -> None:
    bomb = tmp_path / ARCHIVE_NAME
    bomb.write_bytes(archive({"training.csv": "0" * 1_000_000, "testWITHLABELS.csv": TEST_CSV}))
    assert bomb.stat().st_size < 200_000
    with pytest.raises(DownloadError, match=r"training\.csv would unpack to 1,000,000 bytes; refused"):
        unpack(bomb, tmp_path, EXPECTED, max_bytes=900_000)


def test_only_the_two_files_are_unpacked(tmp_path: Path) -> None:
    folder = tmp_path / "outer" / "haart"
    folder.mkdir(parents=True)
    members = {"../../training.csv": TRAINING_CSV, "/tmp/testWITHLABELS.csv": TEST_CSV}
    (folder / ARCHIVE_NAME).write_bytes(archive({**members, "../evil.csv": "evil", "readme.txt": "evil"}))
    obtain(folder, quiet(), NOWHERE, EXPECTED)
    files = [path for path in tmp_path.rglob("*") if path.is_file()]
    assert sorted(files) == sorted([folder / ARCHIVE_NAME, folder / TRAINING_FILE, folder / TEST_FILE])
