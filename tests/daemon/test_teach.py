"""`touchd teach`: one command records, adapts a model and configures it."""

import io
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

from touchd.daemon.app.config import Settings, load
from touchd.daemon.commands import teach
from touchd.daemon.commands.teach import how_to_use
from touchd.daemon.record.dialogue import GESTURES, Dialogue
from touchd.daemon.record.session import Session, Setting
from touchd.drivers.fakes.fake_port import FakePort
from touchd.drivers.frame import Counts
from touchd.drivers.recording import Stream, ideal_clock_ms, write_recordings
from touchd.model.classifier import Classifier
from touchd.model.studies.simulated import simulate


@pytest.mark.parametrize(
    ("config", "pad", "place"),
    [
        ("lab.yaml", None, "set in lab.yaml:"),
        (None, None, "set in touchd.yaml:"),
        ("lab.yaml", "left", "set in lab.yaml, under sensors.left:"),
    ],
)
def test_the_printed_line_sets_the_model(
    tmp_path: Path, config: str | None, pad: str | None, place: str
) -> None:
    model = tmp_path / "a: ö.onnx"
    said = how_to_use(model, Path(config) if config else None, pad, is_better=True)
    assert place in said
    (path := tmp_path / "touchd.yaml").write_text(said.splitlines()[-1])
    assert load(path).model == str(model)


def test_the_service_gets_a_model_outside_home_folders() -> None:
    said = how_to_use(Path("/home/lab/lab 1.onnx"), Path("/etc/touchd/touchd.yaml"), None, is_better=True)
    assert "Copy it: sudo install -m 644 '/home/lab/lab 1.onnx' /etc/touchd/" in said.splitlines()
    assert said.splitlines()[-1] == 'model: "/etc/touchd/lab 1.onnx"'


def test_a_model_not_known_to_be_better_is_not_recommended() -> None:
    said = how_to_use(Path("lab.onnx"), None, None, is_better=False)
    assert "keep the model that you have" in said
    assert "To use it all the same, set in touchd.yaml:" in said


@pytest.mark.parametrize(("asked", "missing"), [([], []), (["--other"], ["other"])])
def test_touches_that_are_no_gesture_are_recorded_if_asked_for(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, asked: list[str], missing: list[str]
) -> None:
    options = teach.parser().parse_args([str(tmp_path), "--participant", "anna", "--rounds", "1", *asked])
    (made,) = simulate((("pat", 1.5),), seed=1)
    for take in Session(tmp_path, Setting("anna"), GESTURES, 1, 6.0, teach.SINGLES).takes():
        write_recordings(take.path, [made], {})
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
    pad = MadePad()
    resting, pressed = pad.counts(nothing(10.0)), pad.counts(palm(10.0, 60.0))

    def hand(counts: Counts, sensor_ms: int) -> bytes:
        """Press every other second, so that each take has touch and rest."""
        now = pressed if sensor_ms // 1000 % 2 else resting
        return encode_fabric_grid(now[sensor_ms // 19 % len(now)], sensor_ms)

    stream = Stream(np.zeros((5400, 8, 8), np.uint16), ideal_clock_ms(5400), ())
    with FakePort(stream, hand, speed=6.0, loop=True) as port:
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
