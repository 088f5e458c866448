"""`touchd plot`: pictures of recordings with touches, answers and pressure over time."""

import dataclasses
import os
from pathlib import Path

import numpy as np
import pytest
from msgspec.structs import replace

pytest.importorskip("matplotlib", reason="matplotlib is not installed")

from matplotlib.figure import Figure
from matplotlib.text import Text
from rigs.made_events import PREDICTION
from rigs.programs import TOUCHD, ran

from touchd.daemon.app import cli
from touchd.daemon.app.config import Settings
from touchd.daemon.app.parts import load_model
from touchd.daemon.commands.plot import picture_of
from touchd.daemon.playback.stream import with_quiet
from touchd.daemon.plot.plot import OTHER_COLOURS, PlotError, Trace, colours_of, draw_recording, trace
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


def drawn_as(demo: Trace, gesture: str, title: str) -> Figure:
    """Draw the demo as if its touches had been recorded as another gesture."""
    spans = tuple(
        span if span.gesture == "notouch" else dataclasses.replace(span, gesture=gesture)
        for span in demo.stream.spans
    )
    stream = dataclasses.replace(demo.stream, spans=spans)
    return draw_recording(dataclasses.replace(demo, stream=stream), title)


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
    # Pressure is above rest.
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
    texts = drawn_as(demo, gesture, "a title").findobj(Text)
    assert ("#c00000" in {text.get_color() for text in texts}) == is_red


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
    figure = drawn_as(demo, "$x_{$", "a $\\title$")
    figure.draw_without_rendering()
    assert {"a $\\title$", "$x_{$"} <= set(words(figure))


@pytest.fixture
def recorded(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    write_simulated(tmp_path / "mine.csv.gz", [("notouch", 1.5), ("rub", 1.5), ("notouch", 1.5)], 4)
    return tmp_path / "mine.csv.gz"


def test_a_notebooks_backend_does_not_matter() -> None:
    environment = {**os.environ, "MPLBACKEND": "nonsense"}
    done = ran([*TOUCHD, "plot", "-o", "mine.csv"], env=environment)
    # Matplotlib has been loaded.
    assert "unknown format" in done.stderr


def test_a_picture_is_written_to_the_working_folder(
    recorded: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert cli.main(["plot", str(recorded)]) == 0
    assert capsys.readouterr().out == "mine.png\n"
    assert Path("mine.png").read_bytes().startswith(PNG)
    # As from an old disk, not in UTF-8.
    odd = recorded.rename(recorded.with_name(os.fsdecode(b"m\xe4rz.csv.gz")))
    assert cli.main(["plot", str(odd), "-o", "a.svg"]) == 0
    assert "<svg" in Path("a.svg").read_text()


@pytest.mark.parametrize(
    ("file", "picture"),
    [
        ("events.jsonl.touches", "events.jsonl.touches.png"),
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


def test_a_labs_own_gestures_have_their_own_colours(demo: Trace) -> None:
    assert list(colours_of(["hug", "poke", "rub"]).values())[-2:] == list(OTHER_COLOURS[:2])
    # Its model may answer what nobody did.
    touch = replace(demo.touches[0], predictions=[replace(PREDICTION, gesture="hug")])
    figure = draw_recording(dataclasses.replace(demo, touches=[touch], starts_s=demo.starts_s[:1]), "a title")
    assert "hug 81%" in words(figure)


def test_a_recording_too_long_for_a_picture_is_refused() -> None:
    long = splice(simulate((("notouch", 301.0),), seed=1))
    with pytest.raises(PlotError, match="301 s do not fit in one picture"):
        traced(long)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["nowhere.csv.gz", "-o", "mine.csv"], "unknown format; end the name of -o with .png"),
        (["mine.csv.gz", "-o", "nowhere/mine.png"], "nowhere/mine.png: cannot be written"),
        (["mine.csv.gz", "notes.txt"], "notes.txt: no known layout"),
        (["nowhere.csv.gz"], "cannot be read"),
    ],
)
def test_an_impossible_picture_is_refused_in_one_line(
    arguments: list[str], message: str, recorded: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    Path("notes.txt").write_text("buy milk\n")
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
