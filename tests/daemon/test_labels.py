"""Labels: what a person says that a touch was, as events and as advice."""

from pathlib import Path

import pytest
from rigs.ended_touch import ended_touch

from touchd.daemon.events import Event, Label, decode, encode
from touchd.daemon.kept.touch_store import TouchStore
from touchd.daemon.labels import LabelError, Labeller

GESTURES = ("notouch", "pat", "stroke")


def test_a_label_is_an_event_like_any_other() -> None:
    events: list[Event] = []
    Labeller(events.append, {"left": GESTURES}, {}).label("left", 7, "pat")
    (label,) = events
    assert isinstance(label, Label)
    assert (label.pad, label.touch, label.gesture) == ("left", 7, "pat")
    assert decode(encode(label)) == label


@pytest.mark.parametrize(("pad", "gesture"), [("right", "pat"), ("left", "hug"), ("left", "")])
def test_a_label_of_something_unknown_is_refused(pad: str, gesture: str) -> None:
    events: list[Event] = []
    with pytest.raises(LabelError):
        Labeller(events.append, {"left": GESTURES}, {}).label(pad, 7, gesture)
    assert events == []


def test_each_ten_labelled_touches_say_how_to_learn(tmp_path: Path) -> None:
    store = TouchStore(tmp_path / "a b", 100, "")
    for number in range(1, 4):
        store.add(ended_touch(number))
        store.label(Label(touch=number, gesture="pat", time=""))
    labeller = Labeller(lambda _: None, {"pad": GESTURES}, {"pad": tmp_path / "a b"})
    said = [labeller.label("pad", touch, "pat") for touch in (1, 2, 2, 2, 3, 4, 5, 6, 7, 8)]
    assert [bool(line) for line in said] == [False] * 8 + [True, False]
    assert f"train --extra '{tmp_path}/a b'" in said[8]


def test_without_kept_frames_it_says_how_to_keep_them() -> None:
    labeller = Labeller(lambda _: None, {"pad": GESTURES}, {})
    said = [labeller.label("pad", touch, "pat") for touch in range(10)]
    assert "journal.keep_touches" in said[-1]
