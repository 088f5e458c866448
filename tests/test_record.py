"""`touchd record`: a person is guided from one recording to the next, and nothing kept is ever lost."""

from __future__ import annotations

import gzip
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from made_pad import MadePad, nothing, palm
from terminal import Terminal

from daemon import cli
from daemon.capture import Capture, Pad, PadLost, complaints
from daemon.config import SensorSettings, Settings
from daemon.record import Session, keep, prepare
from drivers.fake_port import FakePort
from drivers.frame import Counts, Frame
from drivers.protocol import encode_fabric_grid
from drivers.recording import Recording, RecordingError, Stream, ideal_clock_ms, read_recordings
from drivers.simulator import simulate

SPEED = 6.0


class Hand:
    """Encodes a pad at rest, or under a palm, as the test says."""

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


def recording() -> Recording:
    (recording,) = simulate((("pat", 0.5),), seed=1)
    return recording


def session(folder: Path, **changes: object) -> Session:
    usual = Session(folder, "anna", "foam", "fur", ("notouch", "pat", "rub", "stroke"), 3, 0)
    return replace(usual, **changes)  # type: ignore[arg-type]


def test_each_round_asks_every_gesture_in_an_order_that_only_seed_and_person_change(tmp_path: Path) -> None:
    order = [take.gesture for take in session(tmp_path).takes()]
    assert [sorted(order[i : i + 4]) for i in (0, 4, 8)] == [["notouch", "pat", "rub", "stroke"]] * 3
    assert order[:4] != order[4:8] or order[4:8] != order[8:]
    again = session(tmp_path, gestures=("stroke", "rub", "pat", "notouch")).takes()
    assert [take.gesture for take in again] == order
    for change in ({"seed": 1}, {"participant": "ben"}, {"cover": "none"}):
        assert [take.gesture for take in session(tmp_path, **change).takes()] != order
    assert len({take.path for take in again}) == 12


def test_what_is_kept_reads_back_as_it_was_with_where_it_comes_from(tmp_path: Path) -> None:
    path = tmp_path / "x.csv.gz"
    keep(path, recording(), {"sensor": "a pad"})
    (read,) = read_recordings(path)
    np.testing.assert_array_equal(read.counts, recording().counts)
    np.testing.assert_array_equal(read.sensor_ms, recording().sensor_ms)
    assert gzip.decompress(path.read_bytes()).startswith(b"# sensor: a pad\n")
    assert [file.name for file in tmp_path.iterdir()] == ["x.csv.gz"]


def test_nothing_is_ever_written_over(tmp_path: Path) -> None:
    path = tmp_path / "x.csv.gz"
    path.write_text("precious")
    with pytest.raises(RecordingError, match="never written over"):
        keep(path, recording(), {})
    assert path.read_text() == "precious"
    assert [file.name for file in tmp_path.iterdir()] == ["x.csv.gz"]


def test_half_a_file_left_by_a_crash_is_in_nobodys_way(tmp_path: Path) -> None:
    (tmp_path / ".partial-x.csv.gz").write_bytes(b"\x1f\x8b half")
    keep(tmp_path / "x.csv.gz", recording(), {})
    assert len(read_recordings(tmp_path / "x.csv.gz")) == 1
    assert len(list(tmp_path.iterdir())) == 1


def test_a_folder_that_cannot_take_recordings_is_told_before_any_is_made(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    with pytest.raises(RecordingError, match="cannot be kept there"):
        prepare(tmp_path / "file")
    prepare(tmp_path / "new" / "folder")
    assert list((tmp_path / "new" / "folder").iterdir()) == []


def captured(touched_share: float, clock_ms: list[int]) -> Capture:
    frames = tuple(Frame(i, ms, 0.0, np.zeros((8, 8), np.uint16)) for i, ms in enumerate(clock_ms))
    return Capture(frames, touched_share)


@pytest.mark.parametrize(
    ("gesture", "touched_share", "found"),
    [
        ("pat", 0.9, ""),
        ("notouch", 0.0, ""),
        ("notouch", 0.1, "something touched the pad"),
        ("pat", 0.0, "no touch was felt"),
        ("purr", 0.2, "only 20%"),
    ],
)
def test_a_recording_that_does_not_show_its_gesture_is_told(
    gesture: str, touched_share: float, found: str
) -> None:
    told = complaints(captured(touched_share, list(range(0, 1900, 19))), gesture, [])
    assert found in " ".join(told)
    assert bool(told) == bool(found)


def test_lost_frames_and_a_broken_pad_are_told() -> None:
    gaps = [19 * number for number in range(100) if number not in (20, 21, 50)]
    told = complaints(captured(1.0, gaps), "pat", ["row 4 of the pad stands still: a broken wire?"])
    assert told[0].startswith("row 4")
    assert told[1].startswith("3 frames were lost")


def test_a_clock_that_wraps_does_not_break_a_recording() -> None:
    capture = captured(1.0, [2**32 - 19, 0, 19])
    clock_ms = capture.recording("anna", "none", "none", "pat").sensor_ms
    assert np.diff(clock_ms).tolist() == [19, 19]


def test_a_pad_unplugged_while_it_is_recorded_is_told(port: FakePort) -> None:
    with Pad(Settings(sensor=SensorSettings(port=port.path))) as pad:
        assert pad.await_frame(5.0) == ""
        frames = pad.follow(60.0)
        next(frames)
        port.stop()
        with pytest.raises(PadLost, match="went away"):
            list(frames)
        assert "went away" in pad.await_frame(0.3)


def arguments(port: FakePort, folder: Path, *more: str) -> list[str]:
    options = ["--substrate", "foam", "--seconds", "1.5", "--countdown", "1", "--port", port.path]
    return ["record", str(folder), *options, *more]


def test_a_session_is_guided_checked_redone_and_kept(tmp_path: Path, port: FakePort, hand: Hand) -> None:
    options = ("--gestures", "pat,notouch,rub", "--licence", "CC-BY-4.0")
    with Terminal(*arguments(port, tmp_path, *options)) as terminal:
        terminal.until("Who touches the pad?")
        terminal.answer("an na")
        terminal.until("a name has letters")
        terminal.until("Who touches the pad?")
        terminal.answer("anna")
        terminal.until("What is over the pad? [none] ")
        terminal.answer("")
        order = [
            take.gesture for take in session(tmp_path, cover="none", gestures=GESTURES, rounds=1).takes()
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
        assert terminal.process.wait(10) == 0
    assert "no touch was felt" in terminal.shown
    (pat,) = read_recordings(tmp_path / "anna_foam_none_pat_1.csv.gz")
    assert (pat.participant, pat.substrate, pat.cover, pat.gesture) == ("anna", "foam", "none", "pat")
    assert len(pat.counts) == pytest.approx(1.5 * 54, abs=1)
    assert pat.counts[70:].max() > 40
    header = gzip.decompress((tmp_path / "anna_foam_none_pat_1.csv.gz").read_bytes()).decode()
    assert "# licence: CC-BY-4.0\n" in header
    assert "fabric-grid 10x10, crop 1, invert True, at 512000 baud" in header
    assert len(list(tmp_path.iterdir())) == 2


GESTURES = ("pat", "notouch", "rub")


def pat_until_it_is_felt(terminal: Terminal, hand: Hand) -> None:
    """Do it again, and again where a busy machine let the hand come too late."""
    question = ""
    while "keep it" not in question:
        terminal.answer("")
        terminal.until("Enter to begin")
        terminal.answer("")
        terminal.until("pat now")
        hand.presses = True
        terminal.until("  Enter to ")
        hand.presses = False
        question = terminal.until(", s to skip")


def test_only_what_is_not_there_is_asked_for_and_a_crash_leaves_nothing_half(
    tmp_path: Path, port: FakePort
) -> None:
    kept = tmp_path / "anna_foam_fur_notouch_1.csv.gz"
    keep(kept, recording(), {})
    options = ("--participant", "anna", "--cover", "fur", "--gestures", "notouch", "--rounds", "2")
    with Terminal(*arguments(port, tmp_path, *options)) as terminal:
        assert "1 of 2" not in terminal.until("2 of 2: notouch")
        terminal.until("Enter to begin")
        terminal.answer("")
        terminal.until("notouch now")
        terminal.process.kill()
        terminal.process.wait()
    assert list(tmp_path.iterdir()) == [kept]


def test_who_has_had_enough_is_told_how_to_go_on(tmp_path: Path, port: FakePort) -> None:
    options = ("--participant", "anna", "--cover", "fur", "--gestures", "notouch")
    with Terminal(*arguments(port, tmp_path, *options)) as terminal:
        terminal.until("Enter to begin")
        terminal.answer("q")
        terminal.until("the same command goes on from here")
        assert terminal.process.wait(10) == 0


def test_without_anybody_to_answer_it_ends(
    tmp_path: Path, port: FakePort, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    with Path("/dev/null").open() as nobody:
        monkeypatch.setattr("sys.stdin", nobody)
        assert cli.main(arguments(port, tmp_path, "--participant", "anna", "--cover", "fur")) == 0
    assert "Stopped" in capsys.readouterr().out
    assert list(tmp_path.iterdir()) == []


def test_what_cannot_be_recorded_is_one_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["record", str(tmp_path), "--port", "/dev/ttyNowhere"]) == 2
    assert "/dev/ttyNowhere is not there" in capsys.readouterr().err
    for wrong in (["--participant", "a_b"], ["--gestures", "pat,a/b"], ["--rounds", "0"], ["--seconds", "0"]):
        with pytest.raises(SystemExit) as ended:
            cli.main(["record", str(tmp_path), *wrong])
        assert ended.value.code == 2
