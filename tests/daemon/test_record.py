"""`touchd record`: the order of recordings, their files, and complaints about them."""

import io
from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from rich.console import Console
from rigs.made_pad import MadePad, Scans, nothing, palm

from touchd.daemon.app import cli
from touchd.daemon.app.config import SensorSettings, Settings
from touchd.daemon.record import dialogue
from touchd.daemon.record.capture import Capture, Contact, PadReader, complaints
from touchd.daemon.record.dialogue import Dialogue
from touchd.daemon.record.session import Session, Setting, Take
from touchd.daemon.view.terminal import text_width
from touchd.drivers.frame import Frame
from touchd.drivers.recording import RecordingError, prepare_folder, read_recordings
from touchd.model.classifier import Classifier

# What a hand leaves in a soft pad creeps back slowly.
DENT = palm(5.0, 60.0, trembling=False) * np.exp(-np.arange(270, dtype=np.float32) / 200)[:, None, None]


def session(folder: Path, **changes: object) -> Session:
    usual = Session(folder, Setting("anna", "foam", "fur"), ("notouch", "pat", "rub", "stroke"), 3, 8.0)
    return replace(usual, **changes)  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("option", "why"),
    [
        ("--gestures=Pat,notouch", "Pat and pat differ only in spelling"),
        ("--gestures=a-gesture-with-a-long-name", "24 at most"),
        ("--gestures=uncertain,pat", "'uncertain' cannot name a gesture"),
        ("--gestures=pat,a/b", "invalid name 'a/b'"),
        ("--participant=a_b", "invalid name 'a_b'"),
        ("--seconds=0", "'0' is not a number from 1 to 60"),
    ],
)
def test_what_cannot_be_recorded_is_refused_before(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], option: str, why: str
) -> None:
    with pytest.raises(SystemExit):
        cli.main(["record", str(tmp_path / "lab"), option])
    assert why in " ".join(capsys.readouterr().err.split())
    assert not (tmp_path / "lab").exists()


def test_a_missing_port_is_reported_before_a_question(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert cli.main(["record", str(tmp_path), "--port", "/dev/ttyNowhere"]) == 2
    assert "/dev/ttyNowhere is not there; touchd doctor says more" in capsys.readouterr().err


def test_the_setting_alone_decides_the_order(tmp_path: Path) -> None:
    order = [take.gesture for take in session(tmp_path).takes()]
    assert [sorted(order[i : i + 4]) for i in (0, 4, 8)] == [["notouch", "pat", "rub", "stroke"]] * 3
    assert order[:4] != order[4:8] or order[4:8] != order[8:]
    again = session(tmp_path, gestures=("stroke", "rub", "pat", "notouch")).takes()
    assert [take.gesture for take in again] == order
    for setting in (Setting("ben", "foam", "fur"), Setting("anna", "foam")):
        assert [take.gesture for take in session(tmp_path, setting=setting).takes()] != order
    assert len({take.path for take in again}) == 12


def test_a_folder_that_cannot_be_written_is_reported_first(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    with pytest.raises(RecordingError, match="cannot be kept there"):
        prepare_folder(tmp_path / "file")
    prepare_folder(tmp_path / "new" / "folder")
    assert list((tmp_path / "new" / "folder").iterdir()) == []


def test_a_recording_waits_until_the_disk_has_room(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, classifier: Classifier
) -> None:
    one = session(tmp_path, gestures=("pat",), rounds=1)
    (take,) = one.takes()
    take.path.mkdir()
    said = io.StringIO()

    def answer(*_: object) -> str:
        take.path.rmdir()
        return ""

    monkeypatch.setattr(dialogue, "ask", answer)
    guide = Dialogue(Console(file=said), PadReader(Settings(), classifier), one)
    guide._keep(take, captured(1.0, range(0, 54 * 20, 20)))
    assert "not kept yet" in said.getvalue()
    assert len(read_recordings(take.path)) == 1


def captured(touched_share: float, clock_ms: Iterable[int] = range(0, 1900, 19)) -> Capture:
    """A capture of frames at these times of the pad's clock."""
    nothing = np.zeros((8, 8), np.uint16)
    return Capture(tuple(Frame(ms, ms / 1000, nothing) for ms in clock_ms), touched_share)


def once(touch: tuple[int, int] | None) -> Capture:
    return replace(captured(0.0), touch=touch)


@pytest.mark.parametrize(
    ("capture", "gesture", "found"),
    [
        (captured(0.9), "pat", []),
        (captured(0.0), "notouch", []),
        (captured(0.1), "notouch", ["something touched the pad"]),
        (captured(0.0), "pat", ["no touch was detected"]),
        (captured(0.2), "purr", ["only 20%"]),
        (captured(0.0, range(0, 4000, 130)), "pat", ["7.7 frames a second arrive; 8 or more are needed"]),
        (captured(1.0, sorted({*range(0, 1900, 19)} - {380, 399, 950})), "pat", ["3 frames were lost"]),
        (once(None), "pat, once", ["no touch began and ended within 8 s"]),
        (once((100, 2600)), "pat, once", ["that took 2.5 s; once is enough"]),
        (once((2**32 - 100, 900)), "pat, once", []),
    ],
)
def test_a_recording_that_does_not_show_its_gesture_is_reported(
    capture: Capture, gesture: str, found: list[str]
) -> None:
    name, _, single = gesture.partition(", ")
    for troubles in ([], ["row 4 of the 8x8 grid stands still: a broken wire?"]):
        told = complaints(capture, Take(name, Path(), is_single=bool(single)), troubles)
        assert [text in line for text, line in zip([*troubles, *found], told, strict=True)] == [True] * len(
            told
        )


@pytest.mark.parametrize(
    ("pad_format", "scans", "end_ms"),
    [
        pytest.param("fabric-grid", [palm(25.0, 60.0)], 28_000, id="long"),
        pytest.param("fabric-grid", [palm(1.0, 60.0), nothing(4.0) + 8.0], 4000, id="leaving a higher rest"),
        pytest.param("m1616", [palm(1.0, 300.0), DENT], 4000, id="leaving a dent in a finer pad"),
    ],
)
def test_a_recorded_touch_has_a_beginning_and_an_end(
    pad_format: str, scans: list[Scans], end_ms: int, classifier: Classifier
) -> None:
    contact = Contact(Settings(sensor=SensorSettings(format=pad_format)).pipeline, classifier)
    counts = MadePad().counts(np.concatenate([nothing(3.0), *scans, nothing(2.0)]))
    for number, pressure in enumerate(counts):
        contact.update(Frame(round(number * 1000 / 54), number / 54, pressure))
    assert contact.touch == (pytest.approx(3000, abs=100), pytest.approx(end_ms, abs=300))


@pytest.mark.parametrize(("columns", "width"), [(60, 60), (200, 80)])
def test_text_is_at_most_as_wide_as_the_terminal(
    monkeypatch: pytest.MonkeyPatch, columns: int, width: int
) -> None:
    monkeypatch.setenv("COLUMNS", str(columns))
    assert text_width() == width
