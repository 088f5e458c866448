"""`touchd plot`: pictures of touches, answers and pressure over time."""

import os
import sys
from dataclasses import replace
from pathlib import Path

import msgspec
import numpy as np
import pytest

pytest.importorskip("matplotlib", reason="matplotlib is not installed")

from matplotlib.figure import Figure
from matplotlib.text import Annotation, Text
from rigs.made_events import PREDICTION, TIME
from rigs.programs import ran

from touchd.daemon.app import cli
from touchd.daemon.app.config import Settings
from touchd.daemon.commands.plot import picture_of
from touchd.daemon.commands.settings import load_model
from touchd.daemon.path.events import Event, Prediction, Stage, TouchBegan, TouchEnded, encode
from touchd.daemon.playback.stream import with_quiet
from touchd.daemon.plot.plot import (
    OTHER_COLOURS,
    PlotError,
    Trace,
    colour_of,
    draw_recording,
    draw_touches,
    trace,
)
from touchd.daemon.sinks.touches import gather, read_journal
from touchd.drivers.recording import UNLABELLED, Recording, Stream, splice
from touchd.drivers.whole_file import PARTIAL
from touchd.model.studies.simulated import simulate, write_simulated

SCRIPT = (("notouch", 2.0), ("rub", 3.2), ("notouch", 2.0), ("scratch", 3.2), ("notouch", 2.0))
PNG = b"\x89PNG\r\n\x1a\n"


def recordings(seed: int = 4) -> list[Recording]:
    return simulate(SCRIPT, seed)


def traced(stream: Stream) -> Trace:
    return trace(stream, Settings(), load_model(Settings()))


@pytest.fixture(scope="module")
def demo() -> Trace:
    return traced(splice(recordings()))


def words(figure: Figure) -> list[str]:
    """Return all text in a figure."""
    return [text.get_text() for text in figure.findobj(Text)]


def test_touches_are_placed_where_they_truly_began_and_ended(demo: Trace) -> None:
    spans = [span for span in demo.stream.spans if span.gesture != "notouch"]
    assert len(demo.touches) == 2
    for number, span in enumerate(spans):
        assert demo.starts_s[number] == pytest.approx(demo.time_s[span.start], abs=0.2)
        assert demo.ends_s(number) == pytest.approx(demo.time_s[span.stop - 1], abs=0.3)
        assert demo.truth(number) == span.gesture


def test_pressure_is_drawn_above_rest(demo: Trace) -> None:
    load = demo.rise.sum(axis=(1, 2))
    rest, rub = demo.stream.spans[:2]
    assert abs(load[rest.start : rest.stop].mean()) < 10
    assert load[rub.start : rub.stop].mean() > 100


def test_time_continues_when_the_pads_clock_restarts() -> None:
    first, second = recordings(4), recordings(5)
    clocks = [part.sensor_ms - part.sensor_ms[0] for part in (splice(first), splice(second))]
    both = splice([*first, *second])
    both.sensor_ms[:] = np.concatenate(clocks)
    played = traced(both)
    assert (np.diff(played.time_s) > 0).all()
    assert played.time_s[-1] == pytest.approx(2 * 12.4, abs=0.1)
    assert [played.truth(number) for number in range(4)] == ["rub", "scratch"] * 2


@pytest.mark.parametrize(("gesture", "is_red"), [("purr", True), (UNLABELLED, False)])
def test_an_answer_is_wrong_only_where_labels_exist(demo: Trace, gesture: str, is_red: bool) -> None:
    spans = demo.stream.spans
    labelled = tuple(span if span.gesture == "notouch" else replace(span, gesture=gesture) for span in spans)
    figure = draw_recording(replace(demo, stream=replace(demo.stream, spans=labelled)), "a title")
    assert ("#c00000" in {text.get_color() for text in figure.findobj(Text)}) == is_red


def test_every_answer_stands_at_its_mark(demo: Trace) -> None:
    figure = draw_recording(demo, "a title")
    marks = {
        round(float(np.asarray(line.get_xdata())[0]), 2)
        for part in figure.subfigs
        for axes in part.axes
        for line in axes.lines
        if line.get_marker() == "o"
    }
    expected = {
        round(start_s + answer.elapsed_s, 2)
        for start_s, touch in zip(demo.starts_s, demo.touches, strict=True)
        for answer in touch.predictions
    }
    assert len(expected) >= 6
    assert marks == expected
    written = words(figure)
    assert {"a title", "rub", "scratch", "early", "revised", "final"} <= set(written)
    assert sum("mean pad, 0 to " in text for text in written) == 2


def test_a_name_like_a_formula_is_drawn_as_it_is(demo: Trace) -> None:
    spans = tuple(replace(span, gesture="$x_{$") for span in demo.stream.spans)
    figure = draw_recording(replace(demo, stream=replace(demo.stream, spans=spans)), "a $\\title$")
    figure.draw_without_rendering()
    assert {"a $\\title$", "$x_{$"} <= set(words(figure))


@pytest.fixture
def recorded(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    write_simulated(tmp_path / "mine.csv.gz", [("notouch", 1.5), ("rub", 1.5), ("notouch", 1.5)], 4)
    return tmp_path / "mine.csv.gz"


def test_a_picture_is_written_to_the_working_folder(
    recorded: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert cli.main(["plot", str(recorded)]) == 0
    assert capsys.readouterr().out == "mine.png\n"
    assert Path("mine.png").read_bytes().startswith(PNG)
    # As from an old disk, not in UTF-8.
    odd = recorded.rename(recorded.with_name(os.fsdecode(b"m\xe4rz.csv.gz")))
    assert cli.main(["plot", str(odd), "-o", "a.png"]) == 0
    assert Path("a.png").read_bytes().startswith(PNG)


@pytest.mark.parametrize(
    ("file", "picture"),
    [
        ("j.jsonl", "j.png"),
        ("j.jsonl.touches", "j.jsonl.touches.png"),
        ("lab.csv", "lab.png"),
        ("2026-11-25.P3.csv.gz", "2026-11-25.P3.png"),
        ("../lab/.", "lab.png"),
    ],
)
def test_a_picture_is_named_after_its_whole_file_name(file: str, picture: str) -> None:
    assert str(picture_of(Path(file))) == picture


def test_a_folder_of_recordings_becomes_one_picture(
    recorded: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    Path("mine").mkdir()
    for name in ("one", "two"):
        (Path("mine") / f"{name}.csv.gz").write_bytes(recorded.read_bytes())
    # A daemon is saving this one.
    (Path("mine") / f"{PARTIAL}three.csv.gz").touch()
    assert cli.main(["plot", "mine"]) == 0
    assert capsys.readouterr().out == "mine.png\n"
    assert Path("mine.png").read_bytes().startswith(PNG)
    assert cli.main(["classify", "mine"]) == 0


def prediction(touch: int, stage: Stage, gesture: str) -> Prediction:
    return msgspec.structs.replace(PREDICTION, touch=touch, stage=stage, gesture=gesture)


def journal(path: Path) -> Path:
    began = [TouchBegan(touch=n, time=f"2026-11-20T10:00:0{n}.000Z", sensor_ms=1) for n in (1, 2)]
    ended = TouchEnded(touch=1, gesture="stroke", frames=162, reason="released", time="2026-11-20T10:00:05Z")
    answers = [prediction(1, "early", "pat"), prediction(1, "final", "stroke")]
    events: list[Event] = [began[0], *answers, ended, began[1], prediction(2, "early", "pat")]
    path.write_bytes(b"\n".join(map(encode, events)) + b'\n{"type":"pred')
    return path


def test_a_journal_becomes_a_picture_with_each_touch_and_answer(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = journal(tmp_path / "events.jsonl")
    written = words(draw_touches(read_journal(path), "events"))
    assert {"pat 81%, 1 s", "stroke 81%, 1 s"} <= set(written)
    assert "2026-11-20 10:00:01   touch 1: stroke, 3.0 s" in written
    assert "2026-11-20 10:00:02   touch 2: not over" in written
    assert cli.main(["plot", str(path), "-o", str(tmp_path / "a.svg")]) == 0
    assert b"<svg" in (tmp_path / "a.svg").read_bytes()


def test_a_touchs_answers_stand_in_the_order_of_time() -> None:
    """One that is over after 0.35 s has an answer before the first mark."""
    stages: list[tuple[Stage, float]] = [
        ("released", 0.35),
        ("early", 1.0),
        ("revised", 1.5),
        ("final", 2.67),
        ("ongoing", 4.0),
    ]
    answers = [msgspec.structs.replace(prediction(1, stage, "pat"), elapsed_s=at) for stage, at in stages]
    began = TouchBegan(touch=1, time=TIME, sensor_ms=1)
    (axes,) = draw_touches(gather([began, *answers]), "events").axes
    drawn = [(text.xy[0], text.get_text()) for text in axes.texts if isinstance(text, Annotation)]
    assert drawn == [(column, f"pat 81%, {at:g} s") for column, at in enumerate((0.35, 1.0, 1.5, 4.0))]
    assert [tick.get_text() for tick in axes.get_xticklabels()] == ["first", "second", "third", "last"]


def test_a_notebooks_backend_does_not_matter(tmp_path: Path) -> None:
    path = journal(tmp_path / "events.jsonl")
    command = [sys.executable, "-m", "touchd.daemon", "plot", str(path), "-o", str(tmp_path / "a.png")]
    done = ran(command, env={**os.environ, "MPLBACKEND": "module://nonsense"})
    assert (done.returncode, done.stderr) == (0, "")


def test_touches_of_several_pads_are_named_by_pad() -> None:
    began = [TouchBegan(touch=3, time=TIME, sensor_ms=1, pad=pad) for pad in ("arm", "head")]
    written = words(draw_touches(gather(began), "events"))
    assert {f"2026-11-20 10:00:01   {pad}, touch 3: not over" for pad in ("arm", "head")} <= set(written)


def test_a_labs_own_gestures_have_their_own_colours() -> None:
    colours = [colour_of(gesture, ["hug", "poke", "rub"]) for gesture in ("hug", "poke")]
    assert colours == list(OTHER_COLOURS[:2])


def test_a_recording_too_long_for_a_picture_is_refused() -> None:
    long = splice(simulate((("notouch", 301.0),), seed=1))
    with pytest.raises(PlotError, match="301 s do not fit in one picture"):
        traced(long)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["nowhere.csv.gz", "-o", "mine.csv"], "unknown format; end the name of -o with .png"),
        (["mine.csv.gz", "-o", "nowhere/mine.png"], "nowhere/mine.png: cannot be written"),
        (["mine.csv.gz", "notes.txt"], "give one journal, or recordings only"),
        (["notes.txt"], "neither a journal of events nor"),
        (["empty.jsonl"], "holds no touch yet"),
        (["nowhere.jsonl"], "cannot be read"),
    ],
)
def test_an_impossible_picture_is_refused_in_one_line(
    arguments: list[str], message: str, recorded: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    Path("notes.txt").write_text("buy milk\n")
    Path("empty.jsonl").touch()
    assert cli.main(["plot", *arguments]) == 2
    told = capsys.readouterr().err
    assert message in told
    assert len(told.splitlines()) == 1


@pytest.mark.parametrize("count", [1, 2])
def test_recordings_without_rest_return_to_zero_between_strokes(count: int) -> None:
    strokes = [simulate([("notouch", 2.0), ("stroke", 5.0)], seed=4 + n)[1] for n in range(count)]
    beside = traced(with_quiet(strokes, []))
    for span in (span for span in beside.stream.spans if not span.is_added):
        load = beside.rise.sum(axis=(1, 2))[span.start : span.stop]
        assert abs(np.quantile(load, 0.1)) < 15
    figure = draw_recording(beside, "a title")
    drawn = [np.asarray(line.get_xdata()) for axes in figure.subfigs[0].axes for line in axes.lines]
    # Time begins with the recording. Nothing is drawn of the quiet that is played beside it.
    assert min(line[0] for line in drawn) == 0.0
    assert sum(len(line) for line in drawn if len(line) > 50) == sum(len(each.counts) for each in strokes)
