"""Kept touches: the frames as sent, whole files, a bounded number, no delay for the loop."""

import gzip
import os
import shutil
import threading
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest
from rigs.ended_touch import ended_touch, read_frames
from rigs.made_pad import MadePad, nothing, pat
from rigs.scripted_model import Scripted
from rigs.small_disk import log_on_small_disk, needs_small_disk
from rigs.wait import WITHIN_S

from touchd.daemon.app.config import PadSettings, Settings
from touchd.daemon.path.events import Event, Label, SensorEvent, TouchBegan, TouchEnded, encode, timestamp
from touchd.daemon.path.pipeline import Clock, Pipeline, PipelineSettings
from touchd.daemon.sinks.touch_store import (
    LONGEST_FRAMES,
    EndedTouch,
    TouchSink,
    TouchStore,
    file_name,
    folder_of,
    labels_in,
    saved_touches,
    touch_sink,
)
from touchd.drivers.frame import DEFAULT_PAD, NO_TOUCH, Frame
from touchd.drivers.recording import UNLABELLED, RecordingError, read_recordings
from touchd.drivers.whole_file import PARTIAL


@pytest.fixture
def store(tmp_path: Path) -> TouchStore:
    return TouchStore(tmp_path / "touches", 20, "a made pad")


@contextmanager
def sinking(*stores: TouchStore) -> Iterator[TouchSink]:
    sink = TouchSink(dict(zip(("pad", "other"), stores, strict=False)))
    sink.start()
    yield sink
    sink.stop(WITHIN_S)


def numbers(folder: Path) -> list[int]:
    """Return the numbers of the touches in a folder."""
    return [kept.key[1] for kept in saved_touches(folder)]


def put(sink: TouchSink, touch: EndedTouch) -> None:
    """Put a touch's frames, then its events."""
    for frame in touch.frames:
        sink.put_frame(frame)
    sink.put(touch.began)
    sink.put(touch.ended)


def test_a_saved_touch_is_what_the_pad_sent(store: TouchStore, tmp_path: Path) -> None:
    events, now_s = list[Event](), 1795168800.0
    counts = MadePad().counts(np.concatenate([nothing(1.5), pat(2.0), nothing(2.0)]))
    sent = [Frame(round(1000 * number / 54), 100.0, frame) for number, frame in enumerate(counts)]
    with sinking(store) as sink:

        def emit(event: Event) -> None:
            events.append(event)
            sink.put(event)

        clock = Clock(monotonic_s=lambda: 100.0, epoch_s=lambda: now_s)
        pipeline = Pipeline(PipelineSettings(), Scripted(), emit, clock)
        for frame in sent:
            now_s += 1 / 54
            sink.put_frame(frame)
            pipeline.on_frame(frame)
    (start,) = (event for event in events if isinstance(event, TouchBegan))
    (end,) = (event for event in events if isinstance(event, TouchEnded))
    (kept,) = saved_touches(tmp_path / "touches")
    assert kept.key == (start.time, start.touch)
    assert start.sensor_ms == 1500
    assert end.sensor_ms is not None
    frames = read_frames(kept)
    assert len(frames.touch.counts) == end.frames
    for recording, first_ms, last_ms in (
        (frames.before, start.sensor_ms - 1000, start.sensor_ms - 1),
        (frames.touch, start.sensor_ms, end.sensor_ms),
        (frames.after, end.sensor_ms + 1, end.sensor_ms + 797),
    ):
        expected = [frame for frame in sent if first_ms <= frame.sensor_ms <= last_ms]
        assert recording is not None
        assert recording.sensor_ms.tolist() == [frame.sensor_ms for frame in expected]
        np.testing.assert_array_equal(recording.counts, np.stack([frame.pressure for frame in expected]))
    assert [part.gesture for part in read_recordings(kept.path)] == [NO_TOUCH, UNLABELLED, NO_TOUCH]
    assert {frames.touch.participant, frames.touch.substrate, frames.touch.cover} == {UNLABELLED}
    told = gzip.decompress(kept.path.read_bytes()).decode().splitlines()
    assert {"# sensor: a made pad", "# touch: 1", f"# recorded: {start.time}"} < set(told)
    assert "# taken for: stroke (released)" in told


EVERY_100 = range(0, 3000, 100)


@pytest.mark.parametrize("since_ms", [0, 2**32 - 1300], ids=["", "over the wrap"])
@pytest.mark.parametrize(
    ("times_ms", "found_ms", "first_ms", "last_ms", "reason", "pieces"),
    [
        (EVERY_100, 2900, 1200, 1500, "released", [(200, 1100), (1200, 1500), (1600, 2900)]),
        (EVERY_100, 2900, 1150, 1499, "released", [(200, 1100), (1200, 1400), (1500, 2900)]),
        (EVERY_100, 2900, 300, 2900, "released", [(0, 200), (300, 2900)]),
        (EVERY_100, 2900, 1200, 1200, "released", [(200, 1100), (1200, 1200), (1300, 2900)]),
        (EVERY_100, 2900, 0, 3500, "released", [(0, 2900)]),
        # After a touch that was not released, nothing is saved as quiet.
        (EVERY_100, 2900, 1200, 1500, "settled", [(200, 1100), (1200, 1500)]),
        # A fast pad, and a touch that never ends.
        (range(0, 7000, 2), 4000, 3200, 5900, "released", [(2200, 3198), (3200, 5900), (5902, 6998)]),
        (
            range(0, 90_000, 20),
            4000,
            3200,
            80_000,
            "released",
            [(2200, 3180), (3200, 980 + 20 * LONGEST_FRAMES)],
        ),
        # Frames beyond a gap of more than a second are not kept.
        (
            [100, 200, 1200, 1300, 2300, 2400],
            1200,
            1200,
            2300,
            "released",
            [(200, 200), (1200, 2300), (2400, 2400)],
        ),
        ([100, 200, 1201, 1301, 2302, 2402], 1201, 1201, 2302, "released", [(1201, 1301)]),
    ],
)
def test_rest_touch_and_quiet_are_saved_in_bounds(
    store: TouchStore,
    since_ms: int,
    times_ms: Sequence[int],
    found_ms: int,
    first_ms: int,
    last_ms: int,
    reason: Any,
    pieces: list[tuple[int, int]],
) -> None:
    touch, change = ended_touch(1), msgspec.structs.replace
    with sinking(store) as sink:
        for ms in times_ms:
            sink.put_frame(Frame((since_ms + ms) % 2**32, 0.0, touch.frames[0].pressure))
            if ms == found_ms:
                sink.put(change(touch.began, sensor_ms=(since_ms + first_ms) % 2**32))
        sink.put(change(touch.ended, sensor_ms=(since_ms + last_ms) % 2**32, reason=reason))
    (kept,) = saved_touches(store._folder)
    clocks = [(part.sensor_ms - since_ms) % 2**32 for part in read_recordings(kept.path)]
    assert [(clock[0], clock[-1]) for clock in clocks] == pieces


def test_only_the_last_touches_are_saved(tmp_path: Path) -> None:
    store = TouchStore(tmp_path, 5, "")
    for number in range(12):
        store.add(ended_touch(number, rest_frames=0))
        assert len(os.listdir(tmp_path)) <= 5
    assert numbers(tmp_path) == [7, 8, 9, 10, 11]


def said(number: int, gesture: str, pad: str = DEFAULT_PAD) -> Label:
    """Return what a person said of a touch that `ended_touch` made."""
    began = ended_touch(number).began.time
    return Label(touch=number, began=began, gesture=gesture, time=timestamp(0.0), pad=pad)


def test_later_touches_do_not_displace_labelled_ones(tmp_path: Path) -> None:
    store = TouchStore(tmp_path, 5, "", {(said(number, "").began, number) for number in (1, 2, 3)})
    for number in range(1, 30):
        if number in (4, 5, 6):
            # Also while the touch goes on.
            store.label(said(number, "pat"))
        store.add(ended_touch(number, rest_frames=0))
    assert numbers(tmp_path) == [2, 3, 4, 5, 6, 25, 26, 27, 28, 29]


@pytest.mark.parametrize("pad", [DEFAULT_PAD, "left"])
def test_labels_are_read_from_the_journal_beside_the_touches(tmp_path: Path, pad: str) -> None:
    journal = tmp_path / "events.jsonl"
    folder = folder_of(journal, pad)
    assert labels_in(folder) == {}
    store = TouchStore(folder, 20, "")
    for number in (1, 2, 3, 4):
        store.add(ended_touch(number))
    lines = [said(1, "rub", pad), said(1, "pat", pad), said(2, "pat", "other"), said(9, "pat", pad)]
    journal.with_name("events.jsonl.1").write_bytes(b"".join(encode(label) + b"\n" for label in lines))
    # The number of another run's touch.
    other = msgspec.structs.replace(said(4, "pat", pad), began=timestamp(0.0))
    lines = [said(3, NO_TOUCH, pad), other]
    journal.write_bytes(
        b"no event\n" + b"".join(encode(label) + b"\n" for label in lines) + b'{"type":"label'
    )
    found = {int(name.split("-")[-2]): label for name, label in labels_in(folder).items()}
    assert found == {1: "pat", 3: NO_TOUCH}
    sensors = {} if pad == DEFAULT_PAD else {pad: PadSettings(port="/dev/pad")}
    sink = touch_sink(Settings(sensors=sensors), journal, 3)
    labelled = {(said(number, "").began, number) for number in (1, 3, 9)} | {(other.began, 4)}
    assert sink._stores[pad]._labelled == labelled


def test_tags_say_who_touched_what(store: TouchStore, tmp_path: Path) -> None:
    touch = ended_touch(1)
    began = msgspec.structs.replace(touch.began, tags={"participant": "P07", "cover": "fur", "trial": "3"})
    store.add(replace(touch, began=began))
    (kept,) = saved_touches(tmp_path / "touches")
    recording = read_frames(kept).touch
    assert (recording.participant, recording.substrate, recording.cover) == ("P07", UNLABELLED, "fur")


def test_an_unusable_folder_is_reported_with_its_setting(tmp_path: Path) -> None:
    (tmp_path / "events.jsonl.touches").touch()
    for path, why in ((tmp_path / "events.jsonl", "File exists"), (Path("/nowhere/e"), "No such file")):
        with pytest.raises(RecordingError, match=rf"{why}.*give another journal.path"):
            touch_sink(Settings(), path, 3)
    assert not Path("/nowhere").exists()


def test_a_hanging_disk_never_blocks_the_loop(
    store: TouchStore, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    goes_on, add = threading.Event(), store.add
    monkeypatch.setattr(store, "add", lambda touch: (goes_on.wait(WITHIN_S), add(touch)))
    with sinking(store) as sink:
        many = sink.capacity + 4
        for number in range(many):
            put(sink, ended_touch(number))
        assert 3 <= sink.dropped <= 4
        goes_on.set()
    assert len(saved_touches(tmp_path / "touches")) == many - sink.dropped


def test_touches_of_all_pads_may_end_together(tmp_path: Path) -> None:
    sink = TouchSink({f"pad{number}": TouchStore(tmp_path / str(number), 1, "") for number in range(16)})
    touch = ended_touch(1)
    for number in range(16):
        sink.put_frame(touch.frames[0], f"pad{number}")
        sink.put(msgspec.structs.replace(touch.began, pad=f"pad{number}"))
        sink.put(msgspec.structs.replace(touch.ended, pad=f"pad{number}"))
    assert sink.dropped == 0


FILL_A_SMALL_DISK = """
import logging, sys
from pathlib import Path
from rigs.ended_touch import ended_touch, read_frames
from touchd.daemon.sinks.touch_store import TouchStore, saved_touches
logging.basicConfig(level=logging.INFO, format="%(levelname)s %(message)s")
folder = Path(sys.argv[1]) / "touches"
ballast = Path(sys.argv[1]) / "ballast"
ballast.write_bytes(bytes(32_768))
store = TouchStore(folder, 1000, "")
number = 0
while store.lost < 20:
    number += 1
    store.add(ended_touch(number))
whole = [kept.key[1] for kept in saved_touches(folder)]
assert whole == list(range(1, number - 19)), whole
ballast.unlink()
store.add(ended_touch(0))
assert len(saved_touches(folder)) == len(whole) + 1
assert all(len(read_frames(kept).touch.counts) == 20 for kept in saved_touches(folder))
assert len(list(folder.iterdir())) == len(whole) + 1, list(folder.iterdir())
"""


@needs_small_disk
def test_a_full_disk_leaves_only_whole_files(tmp_path: Path) -> None:
    warning, recovery = log_on_small_disk(tmp_path, 96, FILL_A_SMALL_DISK)
    assert warning.startswith("WARNING the frames of touches cannot be saved")
    assert "No space left on device" in warning
    assert recovery.startswith("INFO the frames of touches are saved again; those of 20 were lost")


def test_only_unfinished_files_are_deleted_at_the_start(tmp_path: Path) -> None:
    foreign = {"notes.txt", "anna_foam_fur_rub_1.csv.gz"}
    for name in (*foreign, f"{PARTIAL}2026-11-20T10-00-00.000Z-1-1.csv.gz"):
        (tmp_path / name).touch()
    store = TouchStore(tmp_path, 1, "")
    store.add(ended_touch(1))
    store.add(ended_touch(2))
    assert {path.name for path in tmp_path.iterdir()} == {
        *foreign,
        file_name(ended_touch(2).began.time, 2, 2),
    }


def test_rest_has_no_frames_of_an_earlier_touch(store: TouchStore, tmp_path: Path) -> None:
    touch, change = ended_touch(1), msgspec.structs.replace
    with sinking(store) as sink:
        for ms in range(0, 3000, 100):
            sink.put_frame(Frame(ms, 0.0, touch.frames[0].pressure))
            if ms in (1600, 2400):
                sink.put(change(touch.began, sensor_ms=ms - 600))
                sink.put(change(touch.ended, sensor_ms=ms - 100))
    first, second = (read_frames(kept) for kept in saved_touches(tmp_path / "touches"))
    assert first.before is not None
    assert first.before.sensor_ms.tolist() == list(range(0, 1000, 100))
    assert second.before is not None
    assert second.before.sensor_ms.tolist() == [1600, 1700]


def test_a_failing_folder_loses_touches_with_one_warning(
    store: TouchStore, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    caplog.set_level("INFO")
    folder = tmp_path / "touches"
    store.add(ended_touch(1))
    shutil.rmtree(folder)
    folder.touch()
    store.add(ended_touch(2))
    store.add(ended_touch(3))
    assert store.lost == 2
    folder.unlink()
    # The folder is made again.
    store.add(ended_touch(4))
    failed, again = caplog.messages
    assert failed.startswith("the frames of touches cannot be saved: ")
    assert again.startswith("the frames of touches are saved again; those of 2 were lost")
    assert numbers(folder) == [4]
    assert folder.stat().st_mode & 0o007 == 0


def test_a_folder_that_is_missing_holds_no_touches(tmp_path: Path) -> None:
    assert saved_touches(tmp_path / "nothing") == []
    (tmp_path / "file").touch()
    with pytest.raises(RecordingError, match="file: cannot be read"):
        saved_touches(tmp_path / "file")
    (tmp_path / file_name(timestamp(0.0), 1, 1)).mkdir()
    (tmp_path / file_name(timestamp(0.0), 2, 2)).symlink_to("file")
    assert saved_touches(tmp_path) == []


def test_each_pads_touches_are_saved_without_forgotten_frames(store: TouchStore, tmp_path: Path) -> None:
    touch, change = ended_touch(1), msgspec.structs.replace
    other = TouchStore(tmp_path / "other", 20, "another pad")
    with sinking(store, other) as sink:
        for pad in ("pad", "other"):
            for frame in touch.frames:
                sink.put_frame(frame, pad)
        for event in (
            change(touch.began, pad="other", touch=7),
            touch.began,
            change(touch.ended, pad="other", touch=7),
            said(1, "pat", "other"),
            SensorEvent(state="degraded", time=""),
            SensorEvent(state="down", time="", pad="other"),
            touch.ended,
            change(touch.began, touch=2),
            SensorEvent(state="down", time=""),
            change(touch.ended, touch=2),
        ):
            sink.put(event)
    assert numbers(tmp_path / "touches") == [1]
    assert numbers(tmp_path / "other") == [7]


@pytest.mark.parametrize("name", ["2026-11-20T10-00-00.000Z-1-1.csv.gz", f"{PARTIAL}x"])
def test_a_folder_named_like_a_touch_does_not_stop_deletion(tmp_path: Path, name: str) -> None:
    (tmp_path / "touches" / name).mkdir(parents=True)
    store = TouchStore(tmp_path / "touches", 3, "a made pad")
    for number in range(8):
        store.add(ended_touch(number))
    assert numbers(tmp_path / "touches") == [5, 6, 7]
    assert (tmp_path / "touches" / name).is_dir()


def test_a_clock_that_was_ahead_does_not_delete_new_touches(tmp_path: Path) -> None:
    store = TouchStore(tmp_path, 3, "")
    for number in (1, 2, 3):
        store.add(ended_touch(number, after_s=1e8))
    for number in (4, 5):
        TouchStore(tmp_path, 3, "").add(ended_touch(number))
    assert numbers(tmp_path) == [3, 4, 5]
