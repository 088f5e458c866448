"""SIGHUP: a reload loses no frame, and a wrong configuration changes nothing."""

import gc
import logging
import shutil
import threading
import weakref
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rigs.expectations import LENGTHS, expected, outline
from rigs.made_pad import MadePad, Scans, nothing, palm
from rigs.patient_port import playing
from rigs.robots import Robot
from rigs.running_daemon import SPEED, Daemon
from rigs.wait import WITHIN_S, wait_for

from touchd.daemon.config import JournalSettings, PadSettings, SceneSettings, SensorSettings, Settings
from touchd.daemon.events import Event, Prediction, RobotEvent, SensorEvent, TouchBegan, TouchEnded, decode
from touchd.daemon.health import Health, Notifier
from touchd.daemon.service import Service
from touchd.daemon.setup import reread
from touchd.daemon.setup.destinations import encoder_for
from touchd.daemon.setup.reread import Reloader, rereading
from touchd.daemon.sinks import QueuedSink
from touchd.drivers.fakes.fake_port import FakePort
from touchd.drivers.recording import Stream, ideal_clock_ms
from touchd.drivers.robot.settings import RobotSettings
from touchd.model.classifier import SHIPPED_MODEL


@pytest.fixture
def daemon(tmp_path: Path) -> Iterator[Daemon]:
    with Daemon(tmp_path) as daemon:
        # Before its first event it may not handle signals yet.
        daemon.await_event(SensorEvent)
        yield daemon


def reload(daemon: Daemon, text: str = "", **changes: Any) -> str:
    """Have it read a configuration, or its own with changes; return what it says changed, or why not."""
    count = len(daemon.reloads()) + 1
    if text:
        daemon.write(text)
    else:
        daemon.configure(**changes)
    daemon.await_reloads(count)
    return daemon.reloads()[-1].rpartition("changed: ")[2]


WRONG = {
    "scene: {speak_abov: 0.5}": "scene.speak_abov is not a setting",
    "scene: {gestures: [tap]}": "tap is no gesture",
    "journal: {path: /nowhere/events.jsonl}": "cannot be written",
    "robot: {url: nao}": "not an address",
    "mqtt: {user: nao, password_file: /nowhere}": "mqtt.password_file: /nowhere cannot be read",
}


def test_a_wrong_configuration_changes_nothing(daemon: Daemon) -> None:
    for text, why in WRONG.items():
        line = reload(daemon, text)
        assert line.startswith("WARNING touchd.daemon.setup.reread: the new configuration is refused")
        assert why in line
    assert outline(daemon.finish()) == expected(LENGTHS)


def test_a_reload_that_changes_nothing_waits_for_no_touch() -> None:
    settings = Settings(sensor=SensorSettings(port="/dev/nowhere"))
    # Its loop does not run, as if a touch never ended.
    assert Service(settings, Health(Notifier({}))).reload(settings) == []


def test_a_model_that_is_replaced_under_its_name_is_read_at_a_reload(daemon: Daemon, tmp_path: Path) -> None:
    model = tmp_path / "lab.onnx"
    shutil.copyfile(SHIPPED_MODEL, model)
    assert [reload(daemon, model=str(model)) for _ in range(2)] == ["model", "nothing"]
    shutil.copyfile(SHIPPED_MODEL, tmp_path / "new")
    (tmp_path / "new").replace(model)
    assert reload(daemon, model=str(model)) == "model"
    assert outline(daemon.finish()) == expected(LENGTHS)


def test_a_reload_loses_no_frame_and_no_number(daemon: Daemon, tmp_path: Path) -> None:
    first, second = (JournalSettings(path=str(tmp_path / name)) for name in ("first", "second"))
    assert reload(daemon, journal=first) == "journal"
    daemon.await_event(TouchEnded)
    assert reload(daemon, journal=second, scene=SceneSettings(speak_above=1.0)) == "scene, journal"
    events = daemon.finish()
    assert [event.touch for event in events if isinstance(event, TouchBegan)] == [
        line["touch"] for line in expected(LENGTHS) if line["type"] == "touch_began"
    ]
    before, later = (
        [decode(line) for line in kept.file.read_bytes().splitlines()] for kept in (first, second)
    )
    assert before + later == events[-len(before + later) :]
    assert later
    answers = [event for event in later if isinstance(event, Prediction) and event.touch > 2]
    assert {event.told for event in answers if event.stage in ("early", "revised")} == {False}


def test_a_reload_can_change_the_port(daemon: Daemon) -> None:
    with playing(LENGTHS, SPEED) as other:
        daemon.configure(sensor=SensorSettings(port=other.path))
        while not any(isinstance(e, SensorEvent) and other.path in e.reason for e in daemon.events):
            daemon.await_event(SensorEvent)
        daemon.await_event(TouchEnded)
        states = [event for event in daemon.events if isinstance(event, SensorEvent)]
        assert [state.state for state in states][-2:] == ["down", "up"]
        assert other.path in states[-1].reason


class Heard(QueuedSink[Event]):
    """A sink that keeps what a daemon of two pads says; it may be asked about one of them."""

    def __init__(self) -> None:
        super().__init__("heard")
        self.events: list[Event] = []

    def write(self, item: Event) -> None:
        self.events.append(item)

    def of(self, kind: type[Event], pad: str) -> list[Event]:
        return [event for event in self.events if isinstance(event, kind) and event.pad == pad]


def pressed(*scans: Scans) -> FakePort:
    """A pad that is pressed so, at twice the pace, and then lies at rest."""
    counts = MadePad().counts(np.concatenate([nothing(2.0), *scans, nothing(200.0)]))
    return FakePort(Stream(counts, ideal_clock_ms(len(counts)), ()), encoder_for(SensorSettings()), speed=2.0)


@contextmanager
def serving(settings: Settings) -> Iterator[tuple[Service, Heard]]:
    service, heard, stop = Service(settings, Health(Notifier({}))), Heard(), threading.Event()
    service.tell(heard)
    thread = threading.Thread(target=service.run, args=(stop,))
    level = logging.getLogger().level
    thread.start()
    try:
        yield service, heard
    finally:
        stop.set()
        thread.join()
        # A reload sets it to the configured one.
        logging.getLogger().setLevel(level)


def test_a_pads_other_port_is_read_while_a_hand_lies_on_another_pad() -> None:
    def ports(arm: FakePort) -> Settings:
        return Settings(sensors={"head": PadSettings(port=head.path), "arm": PadSettings(port=arm.path)})

    with pressed(palm(100.0)) as head, pressed() as arm, pressed() as other_arm:
        with serving(ports(arm)) as (service, heard):
            wait_for(lambda: heard.of(TouchBegan, "head"))
            reloading = threading.Thread(target=service.reload, args=(ports(other_arm),))
            reloading.start()
            wait_for(lambda: any(other_arm.path in event.reason for event in heard.of(SensorEvent, "arm")))
            assert not heard.of(TouchEnded, "head")
        reloading.join()


def test_a_pad_that_comes_back_goes_on_counting_its_touches() -> None:
    presses = [palm(0.5), nothing(1.5)]
    with pressed() as head, pressed(*presses * 3) as arm:
        one = Settings(sensors={"head": PadSettings(port=head.path)})
        two = Settings(sensors={**one.sensors, "arm": PadSettings(port=arm.path)})
        with serving(two) as (service, heard):
            wait_for(lambda: heard.of(TouchEnded, "arm"))
            service.reload(one)
            service.reload(two)
            wait_for(lambda: len(heard.of(TouchEnded, "arm")) == 2)
            assert [event.touch for event in heard.of(TouchBegan, "arm")] == [1, 2]


def test_what_a_reload_replaces_is_freed() -> None:
    with pressed() as pad, serving(Settings(sensor=SensorSettings(port=pad.path))) as (service, _):

        def reload(size_mm: float) -> None:
            sensor = SensorSettings(port=pad.path, size_mm=(size_mm, size_mm))
            Reloader(lambda: Settings(sensor=sensor), service.reload).start()
            wait_for(lambda: not reload_threads())

        reload(80.0)
        (only,) = service._parts.pads.values()
        replaced = weakref.ref(only.pipeline)
        del only
        # Python would collect it some time; its megabytes may not wait for that.
        gc.disable()
        try:
            reload(90.0)
            wait_for(lambda: replaced() is None)
        finally:
            gc.enable()


def test_a_reload_adds_and_removes_the_robot(daemon: Daemon) -> None:
    with Robot() as robot:
        daemon.configure(robot=RobotSettings(url=robot.url))
        robot.calls.wait_for_raise("TouchGesture/Status", "up")
        robot.calls.wait_for(lambda call: "TouchGesture/Gesture" in call.arguments)
        daemon.configure()
        robot.calls.wait_for_raise("TouchGesture/Status", "down")
    wait_for(
        lambda: [event.state for event in daemon.events if isinstance(event, RobotEvent)] == ["up", "down"]
    )
    touches = [event.touch for event in daemon.finish() if isinstance(event, TouchBegan)]
    assert touches == list(range(1, len(touches) + 1))


class Held:
    """Something that a reload does, which lasts until `goes_on` is set."""

    def __init__(self) -> None:
        self.begun, self.goes_on = threading.Event(), threading.Event()
        self.given: list[Settings | None] = []
        self.ended = 0

    def __call__(self, settings: Settings | None = None) -> list[str]:
        self.given.append(settings)
        self.begun.set()
        self.goes_on.wait(WITHIN_S)
        self.ended += 1
        return ["language"]


@pytest.fixture
def held() -> Held:
    return Held()


def reload_threads() -> list[threading.Thread]:
    return [thread for thread in threading.enumerate() if thread.name == "touchd-reload"]


def await_message(caplog: pytest.LogCaptureFixture, text: str) -> None:
    wait_for(lambda: text in caplog.text)


def test_an_internal_error_does_not_disable_the_next_reload(caplog: pytest.LogCaptureFixture) -> None:
    divisors = iter([0, 1])
    asked = threading.Event()
    reloader = Reloader(Settings, lambda _: ["scene"] * (1 // next(divisors)))
    with caplog.at_level("INFO"), rereading(asked, reloader):
        asked.set()
        await_message(caplog, "ZeroDivisionError")
        asked.set()
        await_message(caplog, "configuration read again; changed: scene")
    assert "touchd-reread" not in [thread.name for thread in threading.enumerate()]


def test_a_reload_that_hangs_does_not_disable_the_next(caplog: pytest.LogCaptureFixture, held: Held) -> None:
    reads = iter([held, list])

    def read() -> Settings:
        next(reads)()
        return Settings()

    asked = threading.Event()
    with caplog.at_level("INFO"), rereading(asked, Reloader(read, lambda _: ["scene"])):
        asked.set()
        assert held.begun.wait(WITHIN_S)
        asked.set()
        await_message(caplog, "configuration read again")
        held.goes_on.set()
        for thread in reload_threads():
            thread.join(WITHIN_S)
    # The older reload changes nothing when it continues.
    assert caplog.text.count("configuration read again") == 1


def test_of_two_reloads_during_a_long_touch_the_later_one_stays(
    caplog: pytest.LogCaptureFixture, monkeypatch: pytest.MonkeyPatch, held: Held
) -> None:
    monkeypatch.setattr(reread, "PATIENCE_S", 0.05)
    languages = iter(["de", "en"])
    asked = threading.Event()
    with (
        caplog.at_level("INFO"),
        rereading(asked, Reloader(lambda: Settings(language=next(languages)), held)),
    ):
        asked.set()
        assert held.begun.wait(WITHIN_S)
        asked.set()
        await_message(caplog, "this one comes next")
        held.goes_on.set()
        wait_for(lambda: len(held.given) == 2)
    assert [settings.language for settings in held.given] == ["de", "en"]


def test_reloads_that_a_later_one_replaces_do_not_pile_up(
    monkeypatch: pytest.MonkeyPatch, held: Held
) -> None:
    monkeypatch.setattr(reread, "LOOK_S", 0.05)
    reloader = Reloader(Settings, held)
    for _ in range(50):
        reloader.start()
        assert held.begun.wait(WITHIN_S)
    wait_for(lambda: len(reload_threads()) == 2)
    held.goes_on.set()
    wait_for(lambda: not reload_threads())
    assert len(held.given) == 2


def test_the_end_waits_for_a_reload_under_way_and_begins_none(held: Held) -> None:
    asked = threading.Event()
    reloader = Reloader(Settings, held)
    with rereading(asked, reloader):
        asked.set()
        assert held.begun.wait(WITHIN_S)
        reloader.start()
        threading.Timer(0.2, held.goes_on.set).start()
    # Python may end now: nothing is inside a library that would abort.
    assert (len(held.given), held.ended) == (1, 1)
    wait_for(lambda: not reload_threads())
    assert (len(held.given), held.ended) == (1, 1)


def test_a_reload_after_the_end_starts_nothing(tmp_path: Path) -> None:
    settings = Settings(sensor=SensorSettings(port="/dev/nowhere"))
    journal = tmp_path / "events.jsonl"
    service = Service(settings, Health(Notifier({})))
    ended = threading.Event()
    ended.set()
    service.run(ended)
    assert service.reload(Settings(sensor=settings.sensor, journal=JournalSettings(path=str(journal)))) == [
        "journal"
    ]
    assert "touchd-journal" not in [thread.name for thread in threading.enumerate()]
