"""Checks the HAART folder, after downloading what it lacks from the UBC SPIN lab.

The archive is the one that https://www.cs.ubc.ca/labs/spin/data/ links. Only the two files of the 2015
challenge are unpacked, and moved into the folder only after their contents were checked. An archive that is
already there is used: on a bad line, fetch it with a program that resumes.
"""

import lzma
import shutil
import zipfile
import zlib
from collections.abc import Mapping
from dataclasses import dataclass
from http.client import HTTPException
from pathlib import Path, PurePosixPath
from urllib.request import urlopen

from rich.console import Console
from rich.progress import wrap_file

from touchd.drivers.errors import TouchdError
from touchd.drivers.recording import Recording, RecordingError, read_recordings
from touchd.model.training.haart import GESTURES, PUBLISHED_FRAMES, TEST_FILE, TRAINING_FILE, find

ARCHIVE_URL = "https://www.cs.ubc.ca/labs/spin/data/HAART%20DataSet.zip"
ARCHIVE_NAME = "HAART DataSet.zip"
TIMEOUT_S = 30.0
# The two files have 40 and 18 MB; anything ten times larger is another archive.
MAX_FILE_BYTES = 400_000_000


class DownloadError(TouchdError):
    """The recordings could not be downloaded; the message names file, reason and remedy in one line."""


@dataclass(frozen=True)
class Contents:
    """Contents of one file of the set: number of recordings, and participants."""

    recordings: int
    participants: tuple[str, ...]

    def __str__(self) -> str:
        return f"{self.recordings} recordings of {', '.join(self.participants)}"


HAART: Mapping[str, Contents] = {
    TRAINING_FILE: Contents(578, ("P10", "P3", "P4", "P5", "P6", "P7", "P8")),
    TEST_FILE: Contents(251, ("T1", "T2", "T9")),
}


def obtain(
    folder: Path, console: Console, url: str = ARCHIVE_URL, expected: Mapping[str, Contents] = HAART
) -> Mapping[str, Contents]:
    """Download the files that the folder lacks, check all, and return what each holds.

    Raises DownloadError when they cannot be had, RecordingError when a file has other contents.
    """
    found = {name: check(find(folder, name), expected[name]) for name in expected if _is_there(folder, name)}
    missing = {name: contents for name, contents in expected.items() if name not in found}
    if missing:
        archive = folder / ARCHIVE_NAME
        if not archive.exists():
            _download(url, archive, console)
        unpack(archive, folder, missing)
    return {**found, **missing}


def check(path: Path, expected: Contents) -> Contents:
    """Return the file's contents; raises RecordingError if they are unexpected."""
    recordings = read_recordings(path)
    for recording in recordings:
        _check_recording(path, recording)
    participants = tuple(sorted({recording.participant for recording in recordings}))
    found = Contents(len(recordings), participants)
    if found != expected:
        raise RecordingError(
            f"{path}: {found}, where the published file has {expected}; remove it and run `data` again"
        )
    return found


def unpack(
    archive: Path, folder: Path, expected: Mapping[str, Contents], max_bytes: int = MAX_FILE_BYTES
) -> None:
    """Check the expected files, wherever they lie in the archive, then put them into the folder.

    max_bytes: how large each may be. If this raises DownloadError, the folder is unchanged.
    """
    parts = {name: folder / f"{name}.part" for name in expected}
    try:
        with zipfile.ZipFile(archive) as opened:
            for name, part in parts.items():
                member = _member(archive, opened, name, max_bytes)
                with opened.open(member) as source, part.open("wb") as target:
                    shutil.copyfileobj(source, target)
                try:
                    check(part, expected[name])
                except RecordingError as error:
                    why = f"{name}: {str(error).removeprefix(f'{part}: ')}"
                    raise DownloadError(f"{archive}: not the published set ({why})") from error
        for name, part in parts.items():
            part.replace(folder / name)
    except (zipfile.BadZipFile, zlib.error, lzma.LZMAError, EOFError, ValueError, RuntimeError) as error:
        raise DownloadError(f"{archive}: damaged ({error}); delete it and run this again") from error
    except OSError as error:
        raise DownloadError(
            f"{archive}: cannot be unpacked into {folder} ({error.strerror}); check both and run this again"
        ) from error
    finally:
        for part in parts.values():
            part.unlink(missing_ok=True)


def _is_there(folder: Path, name: str) -> bool:
    try:
        return find(folder, name).is_file()
    except RecordingError:
        return False


def _download(url: str, archive: Path, console: Console) -> None:
    part = archive.with_name(f"{archive.name}.part")
    try:
        archive.parent.mkdir(parents=True, exist_ok=True)
        with urlopen(url, timeout=TIMEOUT_S) as response, part.open("wb") as target:
            size = response.length or 0
            with wrap_file(response, size, description=archive.name, console=console) as source:
                shutil.copyfileobj(source, target)
            if response.length:
                raise HTTPException(f"the connection ended {response.length:,} bytes too early")
        part.replace(archive)
    except (OSError, HTTPException, ValueError) as error:
        raise DownloadError(
            f"{url}: cannot be fetched ({error}); run this again, or put the archive there: {archive}"
        ) from error


def _member(archive: Path, opened: zipfile.ZipFile, name: str, max_bytes: int) -> zipfile.ZipInfo:
    members = [info for info in opened.infolist() if PurePosixPath(info.filename).name == name]
    if len(members) != 1:
        raise DownloadError(
            f"{archive}: holds {len(members)} files {name}, not one; is it the HAART archive?"
        )
    # zipfile never unpacks more than a member's stated size, so bounding that is enough.
    if members[0].file_size > max_bytes:
        raise DownloadError(f"{archive}: {name} would unpack to {members[0].file_size:,} bytes; refused")
    return members[0]


def _check_recording(path: Path, recording: Recording) -> None:
    condition = f"{recording.participant}, {recording.substrate}, {recording.cover}, {recording.gesture}"
    if len(recording.counts) != PUBLISHED_FRAMES:
        raise RecordingError(
            f"{path}: {len(recording.counts)} frames of {condition}, not {PUBLISHED_FRAMES}; fetch it again"
        )
    if recording.gesture not in GESTURES:
        raise RecordingError(f"{path}: {condition}: not one of the gestures {', '.join(GESTURES)}")
