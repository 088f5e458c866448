"""Several pads in one daemon: separate touches, and no effect of one pad's faults on others."""

import json
import re
from pathlib import Path

import msgspec
import numpy as np
import pytest
from rigs.call_log import CallLog
from rigs.expectations import GESTURES, LENGTHS, beginning_of, expected, outline, stream_of
from rigs.made_events import PREDICTION
from rigs.patient_port import PATIENT, playing
from rigs.peers import broker, needs_mosquitto, subscribed
from rigs.running_daemon import run_daemon
from rigs.sockets import free_port
from rigs.stub_robot import StubRobot
from rigs.wait import WITHIN_S, wait_for

from touchd.daemon.app import cli
from touchd.daemon.app.config import (
    MAX_PADS,
    ConfigError,
    JournalSettings,
    PadSettings,
    SceneSettings,
    SensorSettings,
    Settings,
    load,
)
from touchd.daemon.app.parts import load_models
from touchd.daemon.bridges.settings import MqttSettings
from touchd.daemon.commands.settings import only_pad
from touchd.daemon.path.events import Event, Prediction, RobotAction, SensorEvent, TouchBegan, TouchEnded
from touchd.daemon.playback.rig import SpawnedDaemon, encoder_for
from touchd.daemon.robot.actions import Action, ActionRule
from touchd.daemon.robot.sink import link_to_robot
from touchd.daemon.sinks.touch_store import folder_of, saved_touches
from touchd.daemon.sinks.touches import decode, gather, read_events
from touchd.drivers.fakes.fake_port import FakePort
from touchd.drivers.pad.format import PadFormat
from touchd.drivers.recording import Stream, ideal_clock_ms
from touchd.drivers.robot.session import RobotSettings
from touchd.model.classifier import SHIPPED_MODEL

SPEED, FLOOD_SPEED = 20.0, 40.0
TIME = "2026-11-20T10:00:00.000Z"


def on(pad: str, events: list[Event]) -> list[Event]:
    return [event for event in events if getattr(event, "pad", "") == pad]


def test_each_pad_has_touches_scene_and_frames_of_its_own(tmp_path: Path) -> None:
    journal = tmp_path / "events.jsonl"
    shown = {"head": 3, "left_arm": 2}
    with (
        playing(beginning_of(LENGTHS, shown["head"]), SPEED) as head,
        playing(beginning_of(GESTURES, shown["left_arm"]), SPEED) as arm,
    ):
        settings = Settings(
            sensors={
                "head": PadSettings(port=head.path),
                "left_arm": PadSettings(port=arm.path, scene=SceneSettings(speak_above=1.0)),
            },
            journal=JournalSettings(path=str(journal), keep_touches=20),
            scene=PATIENT,
        )
        events, _ = run_daemon(settings, tmp_path, head, arm)
    assert outline(on("head", events)) == [line for line in expected(LENGTHS) if line["touch"] in (1, 2, 3)]
    answers = [event for event in on("left_arm", events) if isinstance(event, Prediction)]
    assert {event.told for event in answers if event.stage in ("early", "revised")} == {False}
    for pad, number in shown.items():
        touches = [event.touch for event in on(pad, events) if isinstance(event, TouchBegan)]
        assert touches == list(range(1, number + 1))
        assert [touch.key[1] for touch in saved_touches(folder_of(journal, pad))] == touches
    assert all(touch.ended and touch.predictions for touch in gather(read_events(journal)[0]))


def test_pads_share_a_model_unless_one_has_its_own(tmp_path: Path) -> None:
    own = tmp_path / "own.onnx"
    own.write_bytes(SHIPPED_MODEL.read_bytes())
    sensors = {name: PadSettings(port=name, model=str(own) if name == "c" else None) for name in "abc"}
    models = load_models(Settings(sensors=sensors))
    assert models["a"] is models["b"]
    assert models["c"] is not models["a"]


@needs_mosquitto
def test_each_pads_frames_go_to_its_own_topic(tmp_path: Path) -> None:
    def pressing(counts: int) -> FakePort:
        still = np.full((60, 8, 8), counts, np.uint16)
        stream = Stream(still, ideal_clock_ms(60), ())
        return FakePort(stream, encoder_for(SensorSettings()), loop=True)

    port = free_port()
    with broker(tmp_path, port), subscribed(port, "touchd/+/pressure") as messages:
        with pressing(100) as head, pressing(200) as arm, (tmp_path / "log").open("wb") as log:
            settings = Settings(
                sensors={"head": PadSettings(port=head.path), "arm": PadSettings(port=arm.path)},
                mqtt=MqttSettings(host="127.0.0.1", port=port, pressure_hz=500),
            )
            daemon = SpawnedDaemon(settings, tmp_path, log)
            wait_for(lambda: len({message.topic for message in messages}) == 2 and len(messages) > 20, 20.0)
            assert daemon.stop() == 0
        found = {(message.topic, json.loads(message.payload)["pressure"][0][0]) for message in messages}
    assert found == {("touchd/head/pressure", 100), ("touchd/arm/pressure", 200)}


def test_a_flooding_or_missing_pad_does_not_affect_others(tmp_path: Path) -> None:
    encode = encoder_for(SensorSettings())
    # About as many frames as the daemon's queue holds, so that a busy machine drops none.
    few = beginning_of(LENGTHS, 3)
    with (
        FakePort(stream_of(GESTURES), encode, speed=FLOOD_SPEED, loop=True) as flood,
        FakePort(few, encode, speed=SPEED) as arm,
    ):
        settings = Settings(
            sensors={
                "flood": PadSettings(port=flood.path),
                "left_arm": PadSettings(port=arm.path),
                "folder": PadSettings(port=str(tmp_path)),
                "back": PadSettings(port=str(tmp_path / "unplugged")),
            },
            scene=PATIENT,
        )
        daemon = SpawnedDaemon(settings, tmp_path)
        events: list[Event] = []
        try:
            for event in daemon.events():
                events.append(event)
                if isinstance(event, TouchEnded) and (event.pad, event.touch) == ("left_arm", 3):
                    break
        finally:
            assert daemon.stop() == 0
    said = outline(on("left_arm", events))
    assert said == [line for line in expected(LENGTHS) if line["touch"] in (1, 2, 3)]
    for pad in ("back", "folder"):
        assert {event.state for event in on(pad, events) if isinstance(event, SensorEvent)} == {"down"}


def test_the_robot_gets_each_pads_events_under_its_name() -> None:
    calls, events = CallLog(), list[Event]()
    with StubRobot(calls.add) as robot:
        say = ActionRule(do=(Action(say="{gesture}"),))
        rules: dict[str, tuple[ActionRule, ...]] = {"head": (say,), "left_arm": ()}
        settings = Settings(
            robot=RobotSettings(url=robot.url),
            sensors={
                name: PadSettings(port=name, scene=SceneSettings(actions=actions))
                for name, actions in rules.items()
            },
        )
        sink = link_to_robot(settings, events.append, robot.open_session)
        sink.start()
        # The pad is up only after its first frames.
        calls.wait_for_raise("TouchGesture/head/Status", "down")
        for pad in rules:
            sink.put(SensorEvent(state="up" if pad == "head" else "down", time=TIME, pad=pad))
            sink.put(msgspec.structs.replace(PREDICTION, pad=pad))
        for pad, state in (("head", "up"), ("left_arm", "down")):
            calls.wait_for_raise(f"TouchGesture/{pad}/Status", state)
            calls.wait_for_raise(f"TouchGesture/{pad}/Gesture", "stroke")
        calls.wait_for(lambda call: call.method == "say")
        sink.stop(WITHIN_S)
        assert calls.raised("TouchGesture/head/Status") == ["down", "up", "down"]
        assert [call.method for call in calls.all()].count("say") == 1
        assert [event.pad for event in events if isinstance(event, RobotAction)] == ["head"]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("sensors: {head: {prt: x}}", "sensors[...].prt: unknown setting; did you mean sensors.port?"),
        (
            "sensors: {head: {scene: {speak_above: 2}}}",
            "sensors[...].scene.speak_above: must be",
        ),
        (
            "sensors: {head: {port: 'tcp://pad:4000', format: {rows: 8, columns: 8}}}",
            "a binary format needs a header",
        ),
        (
            f"sensors: {{{', '.join(f'p{n}: {{port: /dev/tty{n}}}' for n in range(MAX_PADS + 1))}}}",
            "sensors: 17 pads, 16 at most; run another touchd",
        ),
        ("sensors: {'a b': {}}", "invalid pad name 'a b'"),
        ("sensors: {a__b: {}}", "invalid pad name 'a__b'"),
        ("sensors: {größe: {}}", "invalid pad name 'größe'"),
        ("sensors: {a: {}, b: {}}", "a and b have the same port, /dev/touchd-pad; give each its own"),
        ("sensors: {a: {port: 'tcp://Pad:1'}, b: {port: 'tcp://pad:1'}}", "a and b have the same port"),
        ("sensors: {a: {}}\nsensor: {baud: 9600}", "sensor and sensors are both set; keep one"),
    ],
)
def test_a_mistake_in_one_of_several_pads_names_it(tmp_path: Path, text: str, message: str) -> None:
    path = tmp_path / "touchd.yaml"
    path.write_text(text)
    with pytest.raises(ConfigError, match=re.escape(message)):
        load(path)


def test_two_names_of_one_device_are_refused_when_read(tmp_path: Path) -> None:
    device, link = tmp_path / "ttyACM0", tmp_path / "touchd-pad"
    device.touch()
    link.symlink_to(device)
    path = tmp_path / "touchd.yaml"
    path.write_text(f"sensors: {{a: {{port: {device}}}, b: {{port: {link}}}}}")
    with pytest.raises(ConfigError, match=f"a and b have the same port, {link}"):
        load(path)


def test_a_command_for_one_pad_asks_which() -> None:
    settings = Settings(sensors={"head": PadSettings(port="a"), "arm": PadSettings(port="b")})
    assert only_pad(settings, "arm").sensor.port == "b"
    assert only_pad(Settings(), None, "c").sensor.port == "c"
    bare = Settings(sensor=SensorSettings(port="udp://0.0.0.0:4000", format=PadFormat(rows=8, columns=8)))
    with pytest.raises(ConfigError, match=r"--port: .*needs a header"):
        only_pad(bare, None, "tcp://pad:4000")
    with pytest.raises(ConfigError, match="leg: no pad has this name; give --pad one of head, arm"):
        only_pad(settings, "leg")


def test_doctor_record_and_classify_use_the_named_pad(
    tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "touchd.yaml"
    path.write_text(
        "sensors: {head: {port: /dev/ttyHead}, arm: {port: /dev/ttyArm, scene: {speak_above: 1.0}}}"
    )
    arm = ["-c", str(path), "--pad", "arm"]
    assert cli.main(["doctor", *arm]) == 1
    assert "/dev/ttyArm is not there" in capfd.readouterr().out
    for command in (["doctor"], ["record", str(tmp_path)], ["classify"], ["run", "--port", "x"]):
        assert cli.main([*command, "-c", str(path)]) == 2
        said = capfd.readouterr().err
        assert "give --pad one of head, arm" in said or "set sensors.NAME.port" in said
    assert cli.main(["record", str(tmp_path), *arm]) == 2
    assert "/dev/ttyArm" in capfd.readouterr().err
    assert cli.main(["classify", str(GESTURES), "--gesture", "rub", "--json", *arm]) == 0
    events = map(decode, capfd.readouterr().out.splitlines())
    answers = [event for event in events if isinstance(event, Prediction)]
    assert [event.told for event in answers if event.stage in ("early", "revised")] == [False] * 2
