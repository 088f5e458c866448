"""`touchd record --from-journal`: kept touches are labelled and saved as recordings, each once."""

import io
from collections.abc import Callable
from pathlib import Path

import msgspec
import numpy as np
import pytest
from rigs.ended_touch import ended_touch
from rigs.expectations import LENGTHS, answers, beginning_of
from rigs.made_events import PREDICTION
from rigs.patient_port import PATIENT, playing
from rigs.running_daemon import run_daemon
from rigs.terminal import Terminal
from rigs.wait import WITHIN_S

from touchd.daemon.app import cli
from touchd.daemon.app.config import JournalSettings, SensorSettings, Settings
from touchd.daemon.path.events import Event, Prediction, TouchBegan, TouchEnded, encode
from touchd.daemon.playback.stream import with_quiet
from touchd.daemon.record.label import RIGHT
from touchd.daemon.sinks.touch_store import EndedTouch, TouchStore, folder_of, kept_touches, read_frames
from touchd.daemon.sinks.touches import read_since
from touchd.drivers.recording import Recording, read_provenance, read_recordings
from touchd.model.classifier import Classifier

SPEED = 20.0


def lines_of(touch: EndedTouch, gesture: str = "pat") -> bytes:
    """Return the journal's lines about a touch that was classified as `gesture`."""
    number, when = touch.began.touch, touch.began.time
    answer = msgspec.structs.replace(
        PREDICTION, touch=number, gesture=gesture, probabilities={gesture: 0.81}, time=when
    )
    ended = TouchEnded(touch=number, gesture=gesture, frames=201, reason="released", time=when)
    return b"".join(encode(event) + b"\n" for event in (touch.began, answer, ended))


class Lab:
    """A journal with touches kept beside it, as the daemon leaves them, and a folder to label them into."""

    def __init__(self, folder: Path) -> None:
        self.journal = folder / "events.jsonl"
        self.folder = folder / "lab"
        self.store = TouchStore(folder_of(self.journal), 100, "a made pad")

    def touched(self, number: int, gesture: str = "pat", after_s: float = 0.0) -> EndedTouch:
        """Journal and keep a touch."""
        touch = ended_touch(number, after_s=after_s)
        self.journalled(touch, gesture)
        self.store.add(touch)
        return touch

    def journalled(self, touch: EndedTouch, gesture: str = "pat") -> None:
        """Journal a touch whose frames are not kept."""
        with self.journal.open("ab") as file:
            file.write(lines_of(touch, gesture))

    def arguments(self, *more: str) -> list[str]:
        return ["record", str(self.folder), "--from-journal", str(self.journal), *more]

    def label(self, *labels: str) -> int:
        """Label from the command line."""
        words = [word for label in labels for word in ("--label", label)]
        return cli.main(self.arguments("--participant", "anna", "--cover", "fur", *words))

    def files(self) -> list[str]:
        return sorted(path.name for path in self.folder.glob("*.csv.gz"))

    def numbers(self, since: str = "") -> list[int]:
        """Return the numbers of the touches in the journal."""
        return [touch.began.touch for touch in read_since(self.journal, since)]


def test_a_touch_deleted_during_labelling_does_not_end_it(lab: Lab) -> None:
    for number, gesture in ((1, "pat"), (2, "rub")):
        lab.touched(number, gesture)
    with Terminal(*lab.arguments(*SAY_WHO)) as terminal:
        terminal.until("1 of 2: touch 2")
        terminal.until("quit: ")
        kept_touches(folder_of(lab.journal))[-1].path.unlink()
        terminal.answer("7", "not kept: ", "2 of 2: touch 1", "quit: ")
        terminal.answer("7", "kept anna_foam_fur_tickle_")
        terminal.answer("q")


def test_a_journal_with_an_early_clock_hides_no_older_one(lab: Lab) -> None:
    early = TouchBegan(touch=9, time="1970-01-01T00:00:07.000Z", sensor_ms=0)
    lab.journal.with_name(f"{lab.journal.name}.1").write_bytes(lines_of(ended_touch(1)))
    lab.journal.write_bytes(encode(early) + b"\n" + lines_of(ended_touch(2)))
    assert lab.numbers(ended_touch(1).began.time) == [1, 2]


@pytest.fixture
def lab(tmp_path: Path) -> Lab:
    return Lab(tmp_path)


SAY_WHO = ("--participant", "anna", "--substrate", "foam", "--cover", "fur")


def test_a_touch_is_labelled_as_a_recording_that_training_reads(
    lab: Lab, capsys: pytest.CaptureFixture[str]
) -> None:
    lab.touched(17)
    assert lab.label("17=tickle") == 0
    (name,) = lab.files()
    assert name.startswith("anna_none_fur_tickle_")
    assert name in capsys.readouterr().out
    (read,) = read_recordings(lab.folder / name)
    assert (read.participant, read.substrate, read.cover, read.gesture) == ("anna", "none", "fur", "tickle")
    (kept,) = kept_touches(folder_of(lab.journal))
    np.testing.assert_array_equal(read.counts, read_frames(kept).touch.counts)
    told = read_provenance(lab.folder / name)
    assert (told["touch"], told["recorded"], told["sensor"]) == ("17", kept.time, "a made pad")
    assert told["source"].startswith("touchd record --from-journal")
    assert told["taken for"] == "rub (released)"
    assert {"labelled", "licence"} <= told.keys()


def test_a_false_touch_is_saved_as_notouch(lab: Lab) -> None:
    lab.touched(17)
    assert lab.label("17=notouch") == 0
    (read,) = read_recordings(lab.folder / lab.files()[0])
    assert len(read.counts) == 40
    assert set(np.diff(read.sensor_ms).tolist()) == {19}


def test_a_label_given_twice_writes_once(lab: Lab, capsys: pytest.CaptureFixture[str]) -> None:
    lab.touched(17)
    assert lab.label("17=tickle") == 0
    assert lab.label("17=tickle") == 0
    assert "exists" in capsys.readouterr().out
    assert lab.label("17=rub") == 2
    assert "exists; delete it to label touch 17 again" in capsys.readouterr().err
    assert len(lab.files()) == 1


def test_a_repeated_number_is_resolved_by_time(lab: Lab, capsys: pytest.CaptureFixture[str]) -> None:
    lab.touched(17)
    later = lab.touched(17, after_s=100.0)
    assert lab.label("17=tickle") == 2
    assert f"2 saved touches have it; choose one by its time, the last are {ended_touch(17).began.time}" in (
        capsys.readouterr().err
    )
    assert lab.label(f"{later.began.time[:19]}=tickle") == 0
    assert lab.files() == [f"anna_none_fur_tickle_{kept_touches(folder_of(lab.journal))[1].path.name}"]


@pytest.mark.parametrize(
    ("label", "message"),
    [
        (
            "99=tickle",
            "99: no saved touch has this number or time; its frames are deleted",
        ),
        ("17=purr", "--label 17: purr is none of --gestures, constant, notouch, pat"),
    ],
)
def test_an_impossible_label_is_refused_in_one_line(
    lab: Lab, capsys: pytest.CaptureFixture[str], label: str, message: str
) -> None:
    lab.touched(17)
    lab.journalled(ended_touch(99))
    assert lab.label("17=tickle", label) == 2
    assert message in capsys.readouterr().err
    assert lab.files() == []


def test_labels_need_a_person_and_a_journal(lab: Lab, capsys: pytest.CaptureFixture[str]) -> None:
    lab.touched(17)
    assert cli.main(lab.arguments("--label", "17=tickle")) == 2
    assert "name the person who touched with --participant" in capsys.readouterr().err
    for wrong in (["--label", "17=tickle"], ["--from-journal", str(lab.journal), "--label", "tickle"]):
        with pytest.raises(SystemExit) as ended:
            cli.main(["record", str(lab.folder), *wrong])
        assert ended.value.code == 2


def test_a_journal_without_kept_touches_says_how_to_keep(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    lab = ["record", str(tmp_path / "lab"), "--from-journal", str(tmp_path / "events.jsonl")]
    assert cli.main(lab) == 2
    assert "events.jsonl: there is no such journal" in capsys.readouterr().err
    (tmp_path / "events.jsonl").touch()
    assert cli.main(lab) == 2
    assert "set journal.keep_touches" in capsys.readouterr().err
    assert not (tmp_path / "lab").exists()


def test_a_lab_s_own_gestures_can_be_labels(lab: Lab) -> None:
    lab.touched(17)
    gestures = ("--participant", "anna", "--gestures", "purr,hug", "--label", "17=purr")
    assert cli.main(lab.arguments(*gestures)) == 0
    assert "_purr_" in lab.files()[0]


def test_kept_touches_are_offered_latest_first(lab: Lab) -> None:
    for number, gesture in ((1, "pat"), (2, "rub"), (3, "stroke"), (4, "scratch")):
        lab.touched(number, gesture)
    lab.journalled(ended_touch(5))
    with Terminal(*lab.arguments("--participant", "anna", "--cover", "fur")) as terminal:
        terminal.until("4 touches are saved; 0 of them have been looked at before")
        terminal.until("1 more are in the journal without frames")
        assert terminal.until("What was under the pad?").index("pat 81%") > 0
        terminal.answer("foam")
        shown = terminal.until("u undo, q quit: ")
        assert "1 of 4: touch 4, answered scratch" in shown
        assert "mean, 0 to" in shown
        assert "early       1.0 s  scratch 81%" in shown
        assert "anna, foam under the pad, fur over it" in shown
        assert "7 tickle" in shown
        terminal.answer("7", "kept anna_foam_fur_tickle_", "2 of 4: touch 3", "quit: ")
        terminal.answer("", "right", "3 of 4: touch 2", "quit: ")
        terminal.answer("w", "Who touched the pad? [anna]")
        terminal.answer("ben")
        for _ in range(2):
            terminal.until("the pad? [")
            terminal.answer("")
        terminal.until("ben, foam under the pad, fur over it")
        terminal.until("quit: ")
        terminal.answer("4", "kept ben_foam_fur_rub_", "4 of 4: touch 1", "quit: ")
        terminal.answer("l", "That was the last touch.", "Enter to end, u undo: ")
        terminal.answer("u", "4 of 4: touch 1", "quit: ")
        terminal.answer("7", "Enter to end, u undo: ")
        terminal.answer("u", "undone", "quit: ")
        terminal.answer("l", "Enter to end, u undo: ")
        terminal.answer("")
        assert terminal.process.wait(WITHIN_S) == 0
    assert [name.rpartition("_")[0] for name in lab.files()] == ["anna_foam_fur_tickle", "ben_foam_fur_rub"]


def test_a_label_can_be_undone_and_a_session_resumed(lab: Lab) -> None:
    for number in (1, 2, 3):
        lab.touched(number)
    with Terminal(*lab.arguments(*SAY_WHO)) as terminal:
        terminal.until("quit: ")
        terminal.answer("u", "nothing to undo", "quit: ")
        terminal.answer("7", "kept anna", "2 of 3", "quit: ")
        terminal.answer("u", "undone", "1 of 3", "quit: ")
        assert lab.files() == []
        terminal.answer("", "2 of 3", "quit: ")
        terminal.answer("u", "1 of 3", "quit: ")
        assert list((lab.folder / RIGHT).iterdir()) == []
        terminal.answer("", "2 of 3", "quit: ")
        terminal.answer("6", "3 of 3")
        terminal.process.kill()
        terminal.process.wait()
    assert len(lab.files()) == 1
    with Terminal(*lab.arguments(*SAY_WHO)) as terminal:
        terminal.until("3 touches are saved; 2 of them have been looked at before")
        terminal.until("1 of 1: touch 1")
        terminal.until("quit: ")
        terminal.answer("q", "the same command continues from here")
        assert terminal.process.wait(WITHIN_S) == 0


def test_without_a_terminal_it_lists_the_touches_and_ends(
    lab: Lab, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    lab.touched(17)
    with Path("/dev/null").open() as nobody:
        monkeypatch.setattr("sys.stdin", nobody)
        assert cli.main(lab.arguments(*SAY_WHO)) == 0
    out = capsys.readouterr().out
    assert "17" in out
    assert "Stopped" in out
    assert lab.files() == []


@pytest.fixture
def listed(
    lab: Lab, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> Callable[[], str]:
    """Skips every touch of a session; returns its output in one line."""

    def listed() -> str:
        monkeypatch.setattr("sys.stdin", io.StringIO("l\n" * 100))
        assert cli.main(lab.arguments(*SAY_WHO)) == 0
        return " ".join(capsys.readouterr().out.split())

    return listed


def test_a_touch_without_journal_lines_is_still_offered(lab: Lab, listed: Callable[[], str]) -> None:
    lab.store.add(ended_touch(1))
    lab.touched(2)
    said = listed()
    assert "touch 1, answered ?" in said
    assert "no longer in the journal" in said
    lab.journal.unlink()
    assert "touch 2, answered ?" in listed()


def test_a_rotated_damaged_journal_is_read_as_far_as_possible(lab: Lab) -> None:
    third, fourth, fifth = (lines_of(ended_touch(number)) for number in (3, 4, 5))
    lab.journal.write_bytes(b'{"type":"pred\n' + fifth + b'\xff\x00 no event\n{"type":"touch_beg')
    lab.journal.with_name("events.jsonl.1").write_bytes(fourth + b"x" * 100_000 + b"\n")
    lab.journal.with_name("events.jsonl.2").write_bytes(third)
    read = read_since(lab.journal, ended_touch(4).began.time)
    assert [(touch.began.touch, len(touch.predictions)) for touch in read] == [(4, 1), (5, 1)]
    assert lab.numbers() == [3, 4, 5]
    assert read_since(lab.journal.with_name("none.jsonl"), "") == []
    (linked := lab.journal.with_name("linked")).symlink_to(lab.journal)
    lab.journal = linked
    assert lab.numbers() == [3, 4, 5]


def test_deleted_and_damaged_touches_are_passed_over(
    lab: Lab, listed: Callable[[], str], monkeypatch: pytest.MonkeyPatch
) -> None:
    for number in (1, 2):
        lab.touched(number)
    first, second = kept_touches(folder_of(lab.journal))
    second.path.write_bytes(second.path.read_bytes()[:100])
    said = listed()
    assert "cannot be read as a recording" in said
    assert "2 of 2: touch 1" in said
    monkeypatch.setattr("touchd.daemon.record.label.kept_touches", lambda _: [first, second])
    first.path.unlink()
    assert "No such file or directory" in listed()


def stages(events: list[Event]) -> list[tuple[str, str]]:
    return [(event.stage, event.gesture) for event in events if isinstance(event, Prediction)]


def test_a_kept_touch_is_labelled_and_classified_again(tmp_path: Path, classifier: Classifier) -> None:
    stream, path = beginning_of(LENGTHS, 5), tmp_path / "events.jsonl"
    with playing(stream, SPEED) as port:
        journal = JournalSettings(path=str(path), keep_touches=20)
        settings = Settings(sensor=SensorSettings(port=port.path), journal=journal, scene=PATIENT)
        events, _ = run_daemon(settings, tmp_path, port)
    kept = kept_touches(folder_of(path))
    began = [event for event in events if isinstance(event, TouchBegan)]
    ended = [event for event in events if isinstance(event, TouchEnded)]
    assert [(touch.time, touch.number) for touch in kept] == [(event.time, event.touch) for event in began]
    for touch, first, last in zip(kept, began, ended, strict=True):
        frames = read_frames(touch).touch
        of_the_touch = (first.sensor_ms <= stream.sensor_ms) & (stream.sensor_ms <= last.sensor_ms)
        assert of_the_touch.sum() == last.frames
        np.testing.assert_array_equal(frames.counts, stream.counts[of_the_touch])
        np.testing.assert_array_equal(frames.sensor_ms, stream.sensor_ms[of_the_touch])

    def again(recordings: list[Recording]) -> list[tuple[str, str]]:
        return stages(answers(with_quiet(recordings, []), classifier))

    said = [event for event in events if isinstance(event, Prediction) and event.touch == 5]
    assert again(read_recordings(kept[4].path)) == stages(said)

    lab = tmp_path / "lab"
    label = ["record", str(lab), "--from-journal", str(path), "--participant", "anna"]
    assert cli.main([*label, "--label", "5=stroke"]) == 0
    (labelled,) = lab.glob("*.csv.gz")
    (recording,) = read_recordings(labelled)
    assert recording.gesture == "stroke"
    np.testing.assert_array_equal(recording.counts, read_frames(kept[4]).touch.counts)
    assert [stage for stage, _ in again([recording])][:3] == ["early", "revised", "final"]
