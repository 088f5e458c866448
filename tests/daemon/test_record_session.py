"""A recording session on a terminal: questions, countdown, checks, repeats, files, resuming."""

import gzip
import io
import os
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from rich.console import Console
from rigs.formats import encode_fabric_grid
from rigs.made_pad import MadePad, nothing, palm
from rigs.terminal import Terminal
from rigs.wait import WITHIN_S

from touchd.daemon.app import cli
from touchd.daemon.app.config import SensorSettings, Settings
from touchd.daemon.record.capture import PadLost, PadReader
from touchd.daemon.record.dialogue import Dialogue
from touchd.daemon.record.session import Session, Setting
from touchd.drivers.fakes.fake_port import FakePort
from touchd.drivers.frame import Counts
from touchd.drivers.recording import Stream, ideal_clock_ms, read_recordings, write_recordings
from touchd.model.classifier import Classifier
from touchd.model.studies.simulated import simulate

SPEED = 4.0
# Long enough for a busy machine to show what a test waits for.
ENDLESS = ("--seconds", "60")


class Hand:
    """Encodes a pad at rest, or under a palm while `presses` is set."""

    def __init__(self) -> None:
        pad = MadePad()
        self._resting, self._pressed = pad.counts(nothing(10.0)), pad.counts(palm(10.0, 60.0))
        self.presses = False

    def __call__(self, counts: Counts, sensor_ms: int) -> bytes:
        now = self._pressed if self.presses else self._resting
        return encode_fabric_grid(now[sensor_ms // 19 % len(now)], sensor_ms)


@pytest.fixture
def hand() -> Hand:
    return Hand()


@pytest.fixture
def port(hand: Hand) -> Iterator[FakePort]:
    stream = Stream(np.zeros((5400, 8, 8), np.uint16), ideal_clock_ms(5400), ())
    with FakePort(stream, hand, speed=SPEED, loop=True) as port:
        yield port


def test_a_pad_unplugged_while_recording_is_reported(port: FakePort, classifier: Classifier) -> None:
    with PadReader(Settings(sensor=SensorSettings(port=port.path)), classifier) as pad:
        frames = pad.follow(60.0)
        next(frames)
        port.stop()
        with pytest.raises(PadLost, match="went away"):
            list(frames)
        with pytest.raises(PadLost, match=r"went away|is not there"):
            next(pad.follow(1.0))


ANNA = ("--participant", "anna", "--cover", "fur", "--gestures", "notouch")


@pytest.fixture
def record(tmp_path: Path, port: FakePort) -> list[str]:
    """The command for short recordings on foam."""
    options = ["--substrate", "foam", "--seconds", "1", "--port", port.path]
    return ["record", str(tmp_path), *options]


def test_a_session_is_guided_checked_redone_and_kept(tmp_path: Path, record: list[str], hand: Hand) -> None:
    with Terminal(*record, "--gestures", "pat,notouch,rub") as terminal:
        terminal.until("Who touches the pad?")
        terminal.answer("an na", "a name has letters", "Who touches the pad?")
        terminal.answer("anna", "What is over the pad? [none] ")
        terminal.answer("")
        order = [
            take.gesture for take in Session(tmp_path, Setting("anna", "foam"), GESTURES, 1, 1.5).takes()
        ]
        for gesture in order:
            terminal.until(f"of 3: {gesture}")
            terminal.until("Enter to begin")
            terminal.answer("s" if gesture == "rub" else "")
            if gesture == "notouch":
                terminal.until("Enter to keep it")
                terminal.answer("")
            elif gesture == "pat":
                terminal.until("Enter to do it again")
                pat_until_it_is_felt(terminal, hand)
                terminal.answer("")
        terminal.until("2 of 3 recordings are in")
        # One is missing.
        assert terminal.process.wait(WITHIN_S) == 1
    assert "no touch was detected" in terminal.shown
    (pat,) = read_recordings(tmp_path / "anna_foam_none_pat_1.csv.gz")
    assert (pat.participant, pat.substrate, pat.cover, pat.gesture) == ("anna", "foam", "none", "pat")
    assert len(pat.counts) == pytest.approx(54, abs=1)
    assert pat.counts[40:].max() > 40
    header = gzip.decompress((tmp_path / "anna_foam_none_pat_1.csv.gz").read_bytes()).decode()
    assert "fabric-grid 10x10, crop 1, invert True, at 512000 baud" in header
    assert len(list(tmp_path.iterdir())) == 2


GESTURES = ("pat", "notouch", "rub")


def pat_until_it_is_felt(terminal: Terminal, hand: Hand) -> None:
    """Repeat the take until the touch is detected; on a busy machine the hand may come too late."""
    question = ""
    while not question.startswith("keep it"):
        terminal.answer("", "Enter to begin")
        terminal.answer("")
        if terminal.until_one("pat now", "  Enter to ") == "pat now":
            # The picture of the pad, and a beep for people who look at their hand.
            shown = terminal.shown.rpartition("Enter to begin")[2]
            assert "▀▀▀▀" in shown
            assert "\a" in shown
            hand.presses = True
            terminal.until("  Enter to ")
            hand.presses = False
        question = terminal.until(", s to skip")


def test_a_session_resumes_after_a_crash(tmp_path: Path, record: list[str]) -> None:
    kept = tmp_path / "anna_foam_fur_notouch_1.csv.gz"
    (recording,) = simulate((("notouch", 0.5),), seed=1)
    write_recordings(kept, [recording], {})
    with Terminal(*record, *ANNA, *ENDLESS, "--rounds", "2") as terminal:
        assert "1 of 2" not in terminal.until("2 of 2: notouch")
        terminal.until("Enter to begin")
        terminal.answer("", "hands off, 6")
        terminal.process.kill()
        terminal.process.wait()
    assert list(tmp_path.iterdir()) == [kept]


def test_q_ends_a_recording_which_is_not_kept(tmp_path: Path, record: list[str]) -> None:
    with Terminal(*record, *ANNA, *ENDLESS) as terminal:
        terminal.until("Enter to begin")
        terminal.answer("", "hands off, 6")
        os.write(terminal._master, b"q")
        terminal.until("the same command continues from here")
        assert terminal.process.wait(WITHIN_S) == 1
    assert list(tmp_path.iterdir()) == []


class Patting(Hand):
    """Encodes a hand that comes for 0.4 s every 3 s."""

    def __call__(self, counts: Counts, sensor_ms: int) -> bytes:
        self.presses = sensor_ms % 3000 < 400
        return super().__call__(counts, sensor_ms)


def test_a_gesture_made_once_is_saved_with_the_rest_around_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, classifier: Classifier
) -> None:
    stream = Stream(np.zeros((5400, 8, 8), np.uint16), ideal_clock_ms(5400), ())
    names = {"pat": "Tätscheln"}
    session = Session(tmp_path, Setting("anna"), (), 1, 1.5, ("pat", "stroke"), flowing=True, names=names)
    monkeypatch.setattr("sys.stdin", io.StringIO("\n" * 40))
    console = Console(file=io.StringIO())
    with (
        FakePort(stream, Patting(), speed=SPEED, loop=True) as port,
        PadReader(Settings(sensor=SensorSettings(port=port.path)), classifier) as pad,
    ):
        Dialogue(console, pad, session).run()
    assert sorted(path.name for path in tmp_path.iterdir()) == [
        "anna_none_none_pat_once-1.csv.gz",
        "anna_none_none_stroke_once-1.csv.gz",
    ]
    assert session.missing() == []
    assert isinstance(console.file, io.StringIO)
    assert "1 of 2: Tätscheln, once" in console.file.getvalue()
    for take in session.takes():
        parts = read_recordings(take.path)
        assert [part.gesture for part in parts] == ["notouch", take.gesture, "notouch"]
        assert {part.participant for part in parts} == {"anna"}
        before, touch, after = (part.counts.max(axis=(1, 2)) for part in parts)
        assert len(before) <= 55
        assert 15 <= len(touch) <= 30
        assert len(after) >= 40
        assert touch.max() > 40 > max(before.max(), after.max())


def test_without_a_terminal_it_ends(
    tmp_path: Path, record: list[str], monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    with Path("/dev/null").open() as nobody:
        monkeypatch.setattr("sys.stdin", nobody)
        assert cli.main([*record, *ANNA]) == 1
    assert "Stopped" in capsys.readouterr().out
    assert list(tmp_path.iterdir()) == []


def test_a_session_that_is_complete_succeeds(tmp_path: Path, record: list[str]) -> None:
    (recording,) = simulate((("notouch", 0.5),), seed=1)
    write_recordings(tmp_path / "anna_foam_fur_notouch_1.csv.gz", [recording], {})
    assert cli.main([*record, *ANNA]) == 0
