"""The command line: its commands, and for every mistake one clear line and the right exit code."""

import errno
import os
import re
import signal
import sys
import threading
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest
from rigs.expectations import DEMO, GESTURES, expected, outline
from rigs.made_events import PREDICTION
from rigs.programs import TOUCHD, ran

from touchd.daemon.app import cli
from touchd.daemon.app.config import ConfigError, SceneSettings, Settings
from touchd.daemon.app.parts import check_scene
from touchd.daemon.commands import demo
from touchd.daemon.path.events import RobotAction, TouchBegan, TouchEnded
from touchd.daemon.playback.stream import with_quiet
from touchd.daemon.robot.actions import Action, ActionRule
from touchd.daemon.robot.words import words_of
from touchd.daemon.sinks.touches import decode
from touchd.daemon.view.describe import describe
from touchd.drivers.recording import Recording, read_recordings
from touchd.model.classifier import Classifier
from touchd.model.studies.simulated import write_simulated

Refusal = Callable[..., str]


@pytest.fixture
def refusal(capfd: pytest.CaptureFixture[str]) -> Refusal:
    """Runs a command that must fail as a user's mistake; returns its one line on standard error."""

    def refusal(*arguments: str) -> str:
        assert cli.main(arguments) == 2
        shown = capfd.readouterr()
        assert shown.out == ""
        assert shown.err.startswith("touchd: ")
        assert len(shown.err.splitlines()) == 1, shown.err
        return shown.err

    return refusal


@pytest.mark.parametrize(("words", "code"), [(["--help"], 0), ([], 2)])
def test_the_help_names_every_command(
    capsys: pytest.CaptureFixture[str], words: list[str], code: int
) -> None:
    assert cli.main(words) == code
    shown = capsys.readouterr().out
    assert all(f"touchd {command}" in shown for command in cli.COMMANDS)


def while_loading(_: Sequence[str]) -> int:
    """As compiled modules do if interrupted while they are imported."""
    try:
        raise KeyboardInterrupt
    except KeyboardInterrupt as error:
        raise ImportError("initialization failed") from error


def while_locking(_: Sequence[str]) -> int:
    """What a condition does if the signal comes while it takes its lock again."""
    try:
        raise KeyboardInterrupt
    finally:
        threading.Lock().release()


def at_work(_: Sequence[str]) -> int:
    raise KeyboardInterrupt


@pytest.mark.parametrize(("command", "code"), [("run", 0), ("doctor", 130)])
@pytest.mark.parametrize("interrupted", [at_work, while_loading, while_locking])
def test_ctrl_c_ends_a_daemon_and_cuts_others_short(
    capfd: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
    command: str,
    code: int,
    interrupted: Callable[[Sequence[str]], int],
) -> None:
    monkeypatch.setattr(cli, "_run", interrupted)
    assert cli.main([command]) == code
    assert capfd.readouterr().err == ""


CTRL_C = "os.kill(os.getpid(), signal.SIGINT)"


@pytest.mark.parametrize(
    "imported",
    [
        # onnxruntime swallows an exception that a signal raises during its import, and crashes in use.
        f"try:\n    {CTRL_C}\nexcept BaseException:\n    pass\n",
        f"import atexit\natexit.register(lambda: {CTRL_C})\nraise KeyboardInterrupt\n",
    ],
    ids=["during the imports", "at the end"],
)
def test_ctrl_c_at_any_moment_leaves_no_trace(tmp_path: Path, imported: str) -> None:
    (tmp_path / "numpy.py").write_text(f"import os, signal\n{imported}")
    done = ran([*TOUCHD, "classify"], env={**os.environ, "PYTHONPATH": str(tmp_path)})
    assert done.returncode == -signal.SIGINT
    assert done.stderr == ""


AS_PROCESS_1 = """
import os, signal
import touchd.daemon.__main__
os.kill(os.getpid(), signal.SIGTERM)
print("lost")
"""


@pytest.mark.skipif(os.geteuid() != 0, reason="only root makes a process 1")
def test_a_container_stops_while_it_starts() -> None:
    done = ran(["unshare", "--pid", "--fork", sys.executable, "-c", AS_PROCESS_1])
    assert (done.returncode, done.stdout) == (128 + signal.SIGTERM, "")


IGNORED = "for number in (signal.SIGINT, signal.SIGHUP): signal.signal(number, signal.SIG_IGN)"
SIGNALS_AT_THE_END = """
import atexit, os, signal, sys
{begin}
for number in (signal.SIGHUP, signal.SIGINT):
    atexit.register(os.kill, os.getpid(), number)
sys.argv[1:] = ["docs"]
from touchd.daemon.__main__ import program
program()
"""


@pytest.mark.parametrize(("begin", "code"), [("", -signal.SIGINT), (IGNORED, 0)], ids=["", "in background"])
def test_signals_after_the_end_leave_no_trace(begin: str, code: int) -> None:
    done = ran([sys.executable, "-c", SIGNALS_AT_THE_END.format(begin=begin)])
    assert (done.returncode, done.stderr) == (code, "")


@pytest.mark.parametrize("command", ["classify", "convert --out x.mcap", "plot"])
def test_a_pipe_or_device_is_refused_as_a_recording(
    tmp_path: Path, refusal: Refusal, monkeypatch: pytest.MonkeyPatch, command: str
) -> None:
    monkeypatch.chdir(tmp_path)
    os.mkfifo("pipe")
    assert "pipe: " in refusal(*command.split(), "pipe")
    assert "/dev/zero: cannot be read" in refusal(*command.split(), "/dev/zero")
    os.mkfifo("pipe.csv.gz")
    assert "pipe.csv.gz: holds no rows" in refusal(*command.split(), "pipe.csv.gz")


def test_a_terminal_without_a_character_shows_a_replacement() -> None:
    program = "from touchd.daemon.app import cli; cli.main(['--version']); print('\u201chi\u201d')"
    shown = ran([sys.executable, "-c", program], env={**os.environ, "PYTHONIOENCODING": "ascii"})
    assert shown.stdout.splitlines()[-1] == "?hi?"


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ("xyz", "xyz is not a command; there are init, run,"),
        ("clasify", "clasify is not a command; did you mean classify?"),
        ("run -c /dev/null --port /dev/\udcff", "an argument or a file's name is not UTF-8"),
        (f"init {'x' * 300}", "File name too long; give another path"),
        ("classify nowhere.csv", "nowhere.csv: cannot be read as a recording (No such file or directory)"),
        (f"classify {GESTURES} --participant nobody", "no recording matches; participant is one of "),
        ("run --view", "--view needs a terminal"),
        ("classify docs", "docs: no recording (.csv or .csv.gz) is in this folder"),
    ],
)
def test_a_mistake_is_reported_in_one_line(refusal: Refusal, words: str, message: str) -> None:
    assert message in refusal(*words.split())


def test_a_terminal_that_cannot_draw_gets_no_view(refusal: Refusal, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("TERM", "dumb")
    monkeypatch.setattr(sys.stdout, "isatty", lambda: True)
    assert "--view needs a terminal, and a TERM other than dumb" in refusal("run", "--view")


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ("run --view --json", "not allowed with"),
        ("run lab.yaml", "unrecognized arguments: lab.yaml; a configuration follows -c, as in -c lab.yaml"),
        ("run --vew", "unrecognized arguments: --vew\n"),
        ("doctor lab.yaml", "as in -c lab.yaml"),
        ("fake-pad lab.yaml", "as in -c lab.yaml"),
        ("doctor --seconds x", "'x' is not a number from "),
        ("doctor --seconds 0", "'0' is not a number from "),
        ("init nowhere/x.yaml --baud 100", "'100' is not a number from "),
        ("record here --rounds 0", "'0' is not a number from "),
    ],
)
def test_an_invalid_option_is_refused_in_words(
    capsys: pytest.CaptureFixture[str], words: str, message: str
) -> None:
    with pytest.raises(SystemExit) as ended:
        cli.main(words.split())
    assert ended.value.code == 2
    assert message in capsys.readouterr().err


@pytest.mark.parametrize("error", [KeyError("oops"), OSError(errno.EIO, "Input/output error")])
def test_an_internal_error_is_one_line_and_exit_1(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], error: Exception
) -> None:
    def fail(words: Sequence[str]) -> int:
        raise error

    monkeypatch.setattr(cli, "_run", fail)
    monkeypatch.delenv("PYTHONPATH", raising=False)
    assert cli.main(["run"]) == 1
    said = f"internal error: {type(error).__name__}: {error}; --debug shows the trace"
    assert capsys.readouterr().err == f"touchd: {said}\n"
    with pytest.raises(type(error)):
        cli.main(["run", "--debug"])


def test_a_pythonpath_that_may_be_the_cause_is_named(tmp_path: Path) -> None:
    (tmp_path / "yaml.py").write_text("")
    done = ran([*TOUCHD, "run"], env={**os.environ, "PYTHONPATH": str(tmp_path)})
    assert done.returncode == 1
    assert "AttributeError: module 'yaml' has no attribute" in done.stderr
    assert done.stderr.endswith("; PYTHONPATH is set: try again after `unset PYTHONPATH`\n")


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("sensor: {prot: csv}", "sensor.prot: unknown setting; did you mean sensor.port?"),
        ("model: nowhere.onnx", "nowhere.onnx: the model cannot be read"),
        ("journal: {path: ~nosuch/events.jsonl}", "~nosuch/events.jsonl: unknown home"),
        ("scene: {gestures: [tap]}", "scene.gestures: tap is not a gesture of the model"),
        ("scene: {actions: [{gestures: [tap], do: [{say: x}]}]}", "scene.actions: tap is not a gesture"),
        ("scene: {gestures: [notouch]}", "scene.gestures: notouch is not a gesture"),
        (
            "scene: {gestures: [pat], actions: [{gestures: [rub], do: [{say: x}]}]}",
            "scene.actions: rub is never told, as scene.gestures leaves it out",
        ),
        ("words: {tikle: {name: a, phrase: b}}", "words.tikle: unknown gesture; known: "),
        ('sensor: {port: "/dev/a\\0b"}', "cannot be opened: embedded null byte"),
        ('journal: {path: "a\\0b"}', "the configuration cannot be used: embedded null"),
        ('model: "a\\0b"', "embedded null"),
        ("sensor: {port: /etc/hostname}", "/etc/hostname is not a serial port"),
        ("sensor: {port: 'nonsense://x'}", "nonsense://x cannot be opened: not an address such as tcp://"),
        ("sensor: {port: 'tcp://nao'}", "cannot be opened: lacks its port; write it as in tcp://nao:4000"),
        ("journal: {path: /nowhere/events.jsonl}", "journal /nowhere/events.jsonl: cannot be written"),
        ("robot: {url: 'udp://nao.local'}", "'udp://nao.local' is not a robot's name or address, such as"),
    ],
)
def test_an_unusable_setting_is_refused_in_one_line(
    tmp_path: Path, refusal: Refusal, text: str, message: str
) -> None:
    path = tmp_path / "touchd.yaml"
    path.write_text(text)
    threads = set(threading.enumerate())
    assert message in refusal("run", "-c", str(path))
    assert set(threading.enumerate()) == threads


def own_model(**metadata: Any) -> Classifier:
    shipped = Classifier.load()
    return replace(shipped, metadata=msgspec.structs.replace(shipped.metadata, **metadata))


def test_actions_on_other_fit_a_model_without_other() -> None:
    rule = ActionRule(do=(Action(say="Ouch"),), gestures=("other",))
    check_scene(SceneSettings(gestures=("pat",), actions=(rule,)), own_model(labels=("notouch", "pat")))


def test_marks_beyond_the_models_longest_window_are_refused() -> None:
    with pytest.raises(ConfigError, match="144 is more than the 100 frames that the model"):
        check_scene(SceneSettings(), own_model(max_length=100))


def test_classify_writes_the_events_as_json_lines(capfd: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["classify", str(GESTURES)]) == 0
    assert outline(decode(line) for line in capfd.readouterr().out.splitlines()) == expected(GESTURES)


def test_classify_plays_only_the_selected_recordings_with_quiet_around_them(
    capfd: pytest.CaptureFixture[str],
) -> None:
    assert cli.main(["classify", str(GESTURES), "--gesture", "rub", "--gesture", "pat"]) == 0
    events = [decode(line) for line in capfd.readouterr().out.splitlines()]
    began = [event.sensor_ms for event in events if isinstance(event, TouchBegan)]
    assert began == [pytest.approx(2500, abs=300), pytest.approx(2 * 2500 + 3200, abs=400)]


def touches_and_quiet() -> tuple[list[Recording], list[Recording]]:
    parts = read_recordings(DEMO)
    touches = [part for part in parts if part.gesture != "notouch"]
    return touches, [part for part in parts if part.gesture == "notouch"]


def test_quiet_borrowed_from_another_person_costs_no_touch() -> None:
    touches, quiet = touches_and_quiet()
    alike = with_quiet(touches, quiet)
    borrowed = with_quiet([replace(touch, participant="somebody else") for touch in touches], quiet)
    assert (np.diff(borrowed.sensor_ms) > 0).all()
    np.testing.assert_array_equal(borrowed.counts, alike.counts)


def test_the_quiet_time_does_not_depend_on_the_pads_rate() -> None:
    touches, quiet = touches_and_quiet()
    fast = replace(quiet[0], counts=np.zeros((4000, 8, 8), np.uint16), sensor_ms=2 * np.arange(4000))
    spans = with_quiet(touches[:1], [fast]).spans
    assert [span.stop - span.start for span in spans if span.gesture == "notouch"] == [2000, 2000]


def test_the_demo_shows_touch_answers_and_robot_and_ends(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    recording = tmp_path / "demo.csv.gz"
    write_simulated(recording, [("notouch", 2.0), ("pat", 3.5), ("notouch", 6.0)], seed=1)
    monkeypatch.setattr(demo, "DEMO_RECORDING", recording)
    monkeypatch.setattr(demo, "PACE", 12.0)
    assert cli.main(["demo"]) == 0
    shown = capfd.readouterr()
    assert shown.err == ""
    in_order = (
        r"the simulated hand: pat\n.*touch 1 begins\n.*  early .*  revised .*  final .*touch 1 ends: .*"
        r"The simulated hand did:  pat\n.*What to try next:\n"
    )
    assert re.search(in_order, shown.out, re.DOTALL)
    assert "robot says “" in shown.out


def test_events_are_described_in_words() -> None:
    words = words_of(Settings())
    assert describe(TouchBegan(touch=7, time="", sensor_ms=1), words) == "touch 7 begins"
    assert describe(PREDICTION, words) == "  early     after  1.0 s: stroke      81%  in 1.9 ms  told"
    ended = TouchEnded(touch=7, gesture="constant", frames=216, reason="gap", time="")
    assert describe(ended, words) == "touch 7 ends: still hand, 4.0 s, too many frames were lost"
    says = RobotAction(touch=7, action="say", what="Hello.", time="")
    assert describe(says, words) == "robot says “Hello.”"
