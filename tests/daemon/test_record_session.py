"""`touchd record` and `touchd teach` on a terminal: questions, checks, files, resuming, the new model."""

import gzip
import io
import os
from collections.abc import Iterator
from contextlib import nullcontext
from pathlib import Path

import numpy as np
import pytest
from rich.console import Console
from rigs import terminal as terminal_rig
from rigs.formats import encode_fabric_grid
from rigs.made_pad import MadePad, nothing, palm
from rigs.terminal import Terminal
from rigs.wait import WITHIN_S

from touchd.daemon.app import cli
from touchd.daemon.app.config import SensorSettings, Settings, load
from touchd.daemon.commands import teach
from touchd.daemon.record.capture import PadLost, PadReader
from touchd.daemon.record.dialogue import GESTURES, HOW_ONCE, Dialogue
from touchd.daemon.record.session import Session, Setting
from touchd.drivers.fakes.fake_port import FakePort
from touchd.drivers.frame import Counts
from touchd.drivers.recording import Stream, ideal_clock_ms, read_recordings, write_recordings
from touchd.model.classifier import Classifier
from touchd.model.studies.simulated import simulate

STREAM = Stream(np.zeros((5400, 8, 8), np.uint16), ideal_clock_ms(5400), ())
SPEED = 4.0
# Long enough for a busy machine to show what a test waits for.
ENDLESS = ("--seconds", "60")
ANNA = ("--participant", "anna", "--cover", "fur", "--gestures", "notouch")


class Hand:
    """Encodes a pad under a palm while `presses` is set, or for `on_ms` of every `every_ms`, else at rest."""

    def __init__(self, on_ms: int = 0, every_ms: int = 1) -> None:
        pad = MadePad()
        self._resting, self._pressed = pad.counts(nothing(10.0)), pad.counts(palm(10.0, 60.0))
        self._on_ms, self._every_ms = on_ms, every_ms
        self.presses = False

    def __call__(self, counts: Counts, sensor_ms: int) -> bytes:
        is_on = self.presses or sensor_ms % self._every_ms < self._on_ms
        now = self._pressed if is_on else self._resting
        return encode_fabric_grid(now[sensor_ms // 19 % len(now)], sensor_ms)


@pytest.fixture
def hand() -> Hand:
    return Hand()


@pytest.fixture
def port(hand: Hand) -> Iterator[FakePort]:
    with FakePort(STREAM, hand, speed=SPEED, loop=True) as port:
        yield port


@pytest.fixture
def record(tmp_path: Path, port: FakePort) -> list[str]:
    """The command for short recordings on foam."""
    options = ["--substrate", "foam", "--seconds", "1", "--port", port.path]
    return ["record", str(tmp_path), *options]


def made(*paths: Path) -> None:
    """Make recordings as if by an earlier session."""
    for path in paths:
        write_recordings(path, simulate((("pat", 1.5),), seed=1), {})


def test_a_pad_unplugged_while_recording_is_reported(port: FakePort, classifier: Classifier) -> None:
    with PadReader(Settings(sensor=SensorSettings(port=port.path)), classifier) as pad:
        frames = pad.follow(60.0)
        next(frames)
        port.stop()
        with pytest.raises(PadLost, match="went away"):
            list(frames)
        with pytest.raises(PadLost, match=r"went away|is not there"):
            next(pad.follow(1.0))


def test_a_session_is_guided_checked_redone_and_saved(tmp_path: Path, record: list[str], hand: Hand) -> None:
    gestures = ("pat", "notouch", "rub")
    with Terminal(*record, "--gestures", ",".join(gestures)) as terminal:
        terminal.until("Who touches the pad?")
        terminal.answer("an na", "a name has letters", "Who touches the pad?")
        terminal.answer("anna", "What is over the pad? [none] ")
        terminal.answer("")
        for take in Session(tmp_path, Setting("anna", "foam"), gestures, 1, 1.5).takes():
            terminal.until(f"of 3: {take.gesture}")
            terminal.until("Enter to begin")
            terminal.answer("s" if take.gesture == "rub" else "")
            if take.gesture == "notouch":
                terminal.until("Enter to keep it")
                terminal.answer("")
            elif take.gesture == "pat":
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
    made(kept)
    with Terminal(*record, *ANNA, *ENDLESS, "--rounds", "2") as terminal:
        assert "1 of 2" not in terminal.until("2 of 2: notouch")
        terminal.until("Enter to begin")
        terminal.answer("", "hands off, 6")
        terminal.process.kill()
        terminal.process.wait()
    assert list(tmp_path.iterdir()) == [kept]
    # One that is complete succeeds.
    assert cli.main([*record, *ANNA]) == 0


def test_q_ends_a_recording_without_saving_it(tmp_path: Path, record: list[str]) -> None:
    with Terminal(*record, *ANNA, *ENDLESS) as terminal:
        terminal.until("Enter to begin")
        terminal.answer("", "hands off, 6")
        os.write(terminal._master, b"q")
        terminal.until("the same command continues from here")
        assert terminal.process.wait(WITHIN_S) == 1
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("hand", [Hand(on_ms=400, every_ms=3000)], ids=["pats every 3 s"])
def test_a_single_gesture_is_saved_with_the_rest_around_it(
    tmp_path: Path, port: FakePort, monkeypatch: pytest.MonkeyPatch, classifier: Classifier
) -> None:
    names = {"pat": "Tätscheln"}
    session = Session(tmp_path, Setting("anna"), (), 1, 1.5, ("pat", "stroke"), flowing=True, names=names)
    monkeypatch.setattr("sys.stdin", io.StringIO("\n" * 40))
    said = io.StringIO()
    with PadReader(Settings(sensor=SensorSettings(port=port.path)), classifier) as pad:
        Dialogue(Console(file=said), pad, session).run()
    assert sorted(path.name for path in tmp_path.iterdir()) == [
        "anna_none_none_pat_once-1.csv.gz",
        "anna_none_none_stroke_once-1.csv.gz",
    ]
    assert session.missing() == []
    assert "1 of 2: Tätscheln, once" in said.getvalue()
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


@pytest.mark.parametrize(
    ("model", "config", "pad", "said"),
    [
        ("a: ö.onnx", "lab.yaml", None, "set in lab.yaml:"),
        ("a: ö.onnx", None, None, "set in touchd.yaml:"),
        ("a: ö.onnx", "lab.yaml", "left", "set in lab.yaml, under sensors.left:"),
        # The service cannot read homes.
        (
            "/home/lab/lab 1.onnx",
            "/etc/touchd/touchd.yaml",
            None,
            "install -m 644 '/home/lab/lab 1.onnx' /etc/touchd/",
        ),
    ],
)
def test_the_printed_line_sets_the_model(
    tmp_path: Path, model: str, config: str | None, pad: str | None, said: str
) -> None:
    shown = teach.how_to_use(Path(model), Path(config) if config else None, pad, is_better=True)
    assert said in shown
    (path := tmp_path / "touchd.yaml").write_text(shown.splitlines()[-1])
    assert load(path).model == ("/etc/touchd/lab 1.onnx" if "/etc/" in said else model)


def test_a_model_not_known_to_be_better_is_not_recommended() -> None:
    said = teach.how_to_use(Path("lab.onnx"), None, None, is_better=False)
    assert "keep the model that you have" in said
    assert "To use it all the same, set in touchd.yaml:" in said


@pytest.mark.parametrize(("asked", "missing"), [([], []), (["--other"], ["other"])])
def test_touches_that_are_no_gesture_are_recorded_if_asked_for(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, asked: list[str], missing: list[str]
) -> None:
    options = cli.options_of("teach", [str(tmp_path), "--participant", "anna", "--rounds", "1", *asked])
    session = Session(tmp_path, Setting("anna"), GESTURES, 1, 6.0, tuple(HOW_ONCE))
    made(*(take.path for take in session.takes()))
    asked_for: list[str] = []
    monkeypatch.setattr(teach, "PadReader", lambda *_: nullcontext())
    monkeypatch.setattr(
        Dialogue, "run", lambda self: asked_for.extend(take.gesture for take in self._session.missing())
    )
    teach._record(Console(file=io.StringIO()), options, Settings())
    assert asked_for == missing


@pytest.mark.slow
@pytest.mark.timeout(400)
def test_one_command_leads_from_pad_to_model(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("torch")
    monkeypatch.setattr(terminal_rig, "SHOWS_WITHIN_S", 200.0)
    # Each take has touch and rest.
    with FakePort(STREAM, Hand(on_ms=1000, every_ms=2000), speed=6.0, loop=True) as port:
        (config := tmp_path / "touchd.yaml").write_text(f"sensor: {{port: {port.path}}}\n")
        options = ["-c", str(config), "--participant", "anna", "--rounds", "1"]
        with Terminal("teach", str(config.with_name("lab")), *options) as terminal:
            answers = {"Enter to begin": "", "Enter to do it again, k": "k", "Enter to keep it": ""}
            while (shown := terminal.until_one(*answers, ", set in")) in answers:
                terminal.answer(answers[shown])
            terminal.until('.onnx"')
            assert terminal.process.wait(WITHIN_S) == 0
    (model,) = config.with_name("lab").glob("*.onnx")
    assert f'model: "{model}"' in terminal.shown
    assert "pat" in Classifier.load(model).labels
    assert "after 1.00 s" in terminal.shown
