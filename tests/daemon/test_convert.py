"""`touchd convert`: CSV and MCAP files hold the same events and frames as their sources."""

import base64
import csv
import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest
from rigs.expectations import DEMO
from rigs.made_events import PREDICTION
from rigs.small_disk import log_on_small_disk, needs_small_disk

from touchd.daemon.app.cli import main
from touchd.daemon.path.events import TouchBegan, encode, epoch_s
from touchd.daemon.sinks.touches import decode
from touchd.drivers.recording import read_recordings, write_recordings

EVENTS = [
    TouchBegan(touch=1, time="2026-11-20T10:00:00.000Z", sensor_ms=81234, pad="head", tags={"trial": "7"}),
    msgspec.structs.replace(PREDICTION, touch=1, pad="head"),
]


@pytest.fixture
def journal(tmp_path: Path) -> Path:
    path = tmp_path / "events.jsonl"
    # Lines as the journal writes them, the last one cut off by a power cut.
    path.write_bytes(b"  \n".join(map(encode, EVENTS)) + b'\n{"type":"touch_en')
    return path


def converted(source: Path, out: Path) -> Path:
    assert main(["convert", str(source), "-o", str(out)]) == 0
    return out


def rows(source: Path) -> list[dict[str, str]]:
    """Return the rows of a journal converted to CSV."""
    with converted(source, source.with_name("events.csv")).open() as file:
        return list(csv.DictReader(file))


def messages(source: Path, folder: Path) -> list[tuple[Any, Any, Any]]:
    """Convert a file to MCAP; return the schema, channel and message of every entry."""
    reader = pytest.importorskip("mcap.reader")
    with converted(source, folder / "out.mcap").open("rb") as file:
        return list(reader.make_reader(file).iter_messages())


def test_a_journal_as_csv_has_a_row_an_event(journal: Path) -> None:
    began, prediction = rows(journal)
    assert [began["type"], prediction["type"]] == ["touch_began", "prediction"]
    assert (began["sensor_ms"], began["probabilities_pat"], began["tags_trial"]) == ("81234", "", "7")
    assert [prediction[name] for name in ("probabilities_pat", "told", "pad")] == ["0.19", "True", "head"]


def test_the_older_files_of_a_journal_come_first(journal: Path, tmp_path: Path) -> None:
    for number, touch in ((1, 6), (2, 5)):
        older = msgspec.structs.replace(EVENTS[0], touch=touch)
        journal.with_name(f"{journal.name}.{number}").write_bytes(encode(older) + b"\n")
    (tmp_path / "linked").mkdir()
    (link := tmp_path / "linked" / "events.jsonl").symlink_to(journal)
    for file in (journal, link):
        assert [row["touch"] for row in rows(file)] == ["5", "6", "1", "1"]


def test_journal_lines_that_are_not_events_are_skipped_and_counted(
    journal: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    lines = journal.read_bytes().split(b"\n")
    journal.write_bytes(b"\n".join([b"\0" * 40, lines[0], b"garbage", *lines[1:]]))
    assert [row["type"] for row in rows(journal)] == ["touch_began", "prediction"]
    assert "skipped 2 lines that are not events" in capsys.readouterr().err


def test_a_journal_as_mcap_keeps_every_event_field_and_time(journal: Path, tmp_path: Path) -> None:
    written = messages(journal, tmp_path)
    assert [(channel.topic, schema.name) for schema, channel, _ in written] == [
        ("/touchd/head/touch_began", "touchd.TouchBegan"),
        ("/touchd/head/prediction", "touchd.Prediction"),
    ]
    assert [decode(message.data) for *_, message in written] == EVENTS
    assert written[0][2].log_time == round(epoch_s(EVENTS[0].time) * 1e9)
    for schema, _, message in written:
        assert set(json.loads(schema.data)["properties"]) == {*json.loads(message.data), "tags"}


def test_a_recording_as_mcap_is_pictures_for_foxglove(tmp_path: Path) -> None:
    first, *others = read_recordings(DEMO)
    # A clock that restarts is as usual.
    clock_ms = first.sensor_ms.copy()
    clock_ms[40:] -= clock_ms[40]
    recordings = [replace(first, sensor_ms=clock_ms), *others]
    write_recordings(tmp_path / "reset.csv", recordings, {})
    written = messages(tmp_path / "reset.csv", tmp_path)
    pictures = [message for schema, _, message in written if schema.name == "foxglove.RawImage"]
    labels = [
        json.loads(message.data) for _, channel, message in written if channel.topic == "/touchd/recording"
    ]
    assert [label["gesture"] for label in labels] == [recording.gesture for recording in recordings]
    assert len(pictures) == sum(len(recording.counts) for recording in recordings)
    pixels = np.frombuffer(base64.b64decode(json.loads(pictures[3].data)["data"]), "<u2").reshape(8, 8)
    np.testing.assert_array_equal(pixels, first.counts[3])
    times = [message.log_time for *_, message in written]
    assert times == sorted(times)


@pytest.mark.parametrize(
    ("file", "out", "said"),
    [
        ("events.jsonl", "events.xlsx", "unknown format; end the name of --out with .csv or .mcap"),
        ("nowhere", "events.csv", "cannot be read (No such file or directory)"),
        ("empty", "events.csv", "no events in it"),
        ("events.jsonl", "events.jsonl.csv/x.csv", "No such file or directory"),
        ("text", "events.csv", "text, line 1: not an event"),
        ("zeros", "events.csv", "zeros, line 1: longer than any event"),
        ("pad.csv.gz", "events.csv", "a recording is CSV already; end the name of --out with .mcap"),
        ("events.jsonl", "mine.csv", "exists; give another --out, or move the file away"),
    ],
)
def test_an_impossible_conversion_is_refused_in_one_line(
    journal: Path, capsys: pytest.CaptureFixture[str], file: str, out: str, said: str
) -> None:
    (journal.parent / "empty").touch()
    (journal.parent / "text").write_text("hello\n")
    (journal.parent / "mine.csv").write_text("mine")
    (journal.parent / "zeros").write_bytes(bytes(100_000))
    before = {path: path.read_bytes() for path in journal.parent.iterdir()}
    assert main(["convert", str(journal.parent / file), "-o", str(journal.parent / out)]) == 2
    assert said in capsys.readouterr().err
    assert {path: path.read_bytes() for path in journal.parent.iterdir()} == before


FILL = """
import os, sys, tempfile
from rigs.made_events import PREDICTION
from touchd.daemon.app.cli import main
from touchd.daemon.path.events import encode
os.chdir(sys.argv[1])
with tempfile.NamedTemporaryFile(dir="/var/tmp") as journal:
    journal.write((encode(PREDICTION) + b"\\n") * 1000)
    journal.flush()
    assert main(["convert", journal.name, "-o", "mine.csv"]) == 2
assert os.listdir() == []
"""


@needs_small_disk
def test_a_conversion_on_a_full_disk_names_its_file(tmp_path: Path) -> None:
    (told,) = log_on_small_disk(tmp_path, 40, FILL)
    assert told == "touchd: mine.csv: cannot be written (No space left on device); give another --out"
