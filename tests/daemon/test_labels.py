"""Labels: what a person says that a touch was, as events and as advice."""

import os
import signal
import termios
import time
from pathlib import Path

import pytest
from msgspec.structs import replace
from rigs.expectations import LENGTHS
from rigs.made_events import touch
from rigs.patient_port import playing
from rigs.terminal import Terminal
from rigs.wait import WITHIN_S, wait_for

from touchd.daemon.path.events import Event, Label, encode
from touchd.daemon.sinks.labels import Labeller, keys_of
from touchd.daemon.sinks.touch_store import folder_of, labels_in, saved_touches
from touchd.daemon.sinks.touches import decode

GESTURES = ("notouch", "pat", "stroke")


def test_a_label_is_an_event_like_any_other() -> None:
    events: list[Event] = []
    Labeller(events.append, {"left": GESTURES}, are_saved=True).label(replace(touch(7), pad="left"), "pat")
    (label,) = events
    assert isinstance(label, Label)
    assert (label.pad, label.touch, label.began, label.gesture) == ("left", 7, touch(7).time, "pat")
    assert decode(encode(label)) == label


def test_the_gestures_keys_do_not_depend_on_other() -> None:
    without = keys_of(("constant", "notouch", "pat"))
    assert keys_of(("constant", "notouch", "other", "pat")) == without | {"3": "other"}


def test_labels_without_saved_touches_are_warned_of_once(caplog: pytest.LogCaptureFixture) -> None:
    for are_saved in (True, False):
        labeller = Labeller(lambda _: None, {"pad": GESTURES}, are_saved=are_saved)
        for number in (1, 2, 3):
            labeller.label(touch(number), "pat")
    (warning,) = caplog.messages
    assert warning.startswith("set journal.keep_touches")


def test_a_key_labels_the_touch_on_the_screen(tmp_path: Path) -> None:
    journal = tmp_path / "events.jsonl"
    config = tmp_path / "touchd.yaml"
    with playing(LENGTHS, 2.0) as port:
        config.write_text(
            f"sensor: {{port: {port.path}}}\njournal: {{path: {journal}, keep_touches: 20}}\nlanguage: de\n"
        )
        with Terminal("run", "--view", "-c", str(config)) as terminal:
            terminal.until("It was: 1 ruhende Hand")
            # Neither arrow keys nor keys without a gesture say anything.
            for keys in (b"\x1b[A", b"z", b"2"):
                os.write(terminal._master, keys)
                time.sleep(0.1)
            terminal.until("touch 1 was: Tätscheln")
            wait_for(lambda: labels_in(folder_of(journal)))
            terminal.process.send_signal(signal.SIGINT)
            assert terminal.process.wait(WITHIN_S) == 0
            # The terminal echoes again.
            assert termios.tcgetattr(terminal._master)[3] & termios.ECHO
    labels = [event for line in journal.open("rb") if isinstance(event := decode(line), Label)]
    assert [(label.touch, label.gesture) for label in labels] == [(1, "pat")]
    first = saved_touches(folder_of(journal))[0]
    assert labels_in(folder_of(journal)) == {first.path.name: "pat"}
