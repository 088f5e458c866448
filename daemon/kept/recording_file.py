"""A file of a lab's own recordings: there whole or not at all, and never written over."""

import os
from collections.abc import Mapping, Sequence
from pathlib import Path

from touchd.drivers.errors import os_errors_as
from touchd.drivers.recording import Recording, RecordingError, write_recordings
from touchd.drivers.whole_file import PARTIAL, PRIVATE_MODE, whole_file

SUFFIX = ".csv.gz"


def prepare(folder: Path) -> None:
    """Make the folder, and see that recordings can be kept in it; raises RecordingError where they cannot."""
    probe = folder / f".touchd-probe-{os.getpid()}"
    with os_errors_as(RecordingError, f"{folder}: recordings cannot be kept there", "name another folder"):
        folder.mkdir(parents=True, exist_ok=True)
        try:
            probe.touch()
        finally:
            probe.unlink(missing_ok=True)


def keep(path: Path, recordings: Sequence[Recording], provenance: Mapping[str, str]) -> None:
    """Write recordings to a new file, whole or not at all; raises RecordingError, also when it exists."""
    try:
        with whole_file(path, replace=False, mode=PRIVATE_MODE) as partial:
            write_recordings(partial, recordings, provenance)
    except RecordingError as error:
        raise RecordingError(str(error).replace(PARTIAL, "")) from error
    except FileExistsError as error:
        raise RecordingError(f"{path}: is there already, and is never written over") from error
    except OSError as error:
        raise RecordingError(f"{path}: cannot be written ({error.strerror})") from error
