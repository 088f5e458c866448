"""Events as lines of JSON: the contract with readers of stdout and the journal."""

import json
import re
import typing
from pathlib import Path

import msgspec
import pytest
from rigs.made_events import PREDICTION, TIME

from touchd.daemon.path.events import (
    MAX_REASON_BYTES,
    EndReason,
    Event,
    PadState,
    RobotAction,
    RobotEvent,
    SensorEvent,
    Stage,
    TouchBegan,
    TouchEnded,
    encode,
    epoch_s,
    timestamp,
)
from touchd.daemon.path.feel import Feel
from touchd.daemon.sinks.touches import EventError, decode
from touchd.drivers.errors import one_line
from touchd.model.classifier import ModelMetadata

EVENTS: list[tuple[Event, str]] = [
    (
        TouchBegan(touch=2**53, time=TIME, sensor_ms=0),
        '{"type":"touch_began","touch":9007199254740992,"time":"TIME","sensor_ms":0,"pad":"pad"}',
    ),
    (
        PREDICTION,
        '{"type":"prediction","touch":7,"stage":"early","frames":54,"elapsed_s":1.0,"gesture":"stroke",'
        '"confidence":0.81,"probabilities":{"pat":0.19,"stroke":0.81},"changed":true,"told":true,'
        '"degraded":false,"latency_ms":1.9,"model":"touchd-1","time":"TIME","pad":"pad","age_ms":0.0,'
        '"feel":null,"perhaps":""}',
    ),
    (
        TouchEnded(touch=7, gesture="stroke", frames=201, reason="released", time=TIME, sensor_ms=84937),
        '{"type":"touch_ended","touch":7,"gesture":"stroke","frames":201,"reason":"released",'
        '"time":"TIME","sensor_ms":84937,"pad":"pad","feel":null}',
    ),
    (
        SensorEvent(state="down", time=TIME, reason="unplugged"),
        '{"type":"sensor","state":"down","time":"TIME","reason":"unplugged","pad":"pad"}',
    ),
    (RobotEvent(state="up", time=TIME), '{"type":"robot","state":"up","time":"TIME","reason":""}'),
]


@pytest.mark.parametrize(("event", "text"), EVENTS, ids=[type(event).__name__ for event, _ in EVENTS])
def test_an_event_survives_its_line_of_json(event: Event, text: str) -> None:
    line = encode(event)
    assert json.loads(line) == json.loads(text.replace("TIME", TIME))
    assert b"\n" not in line
    assert decode(line) == event


@pytest.mark.parametrize(
    "line",
    [
        *(b"", b"{", b'{"type":"unheard_of"}', b'{"type":"touch_began","touch":"seven"}', b"\xff"),
        b'{"type":"touch_began","touch":-1,"time":"2026-11-20T10:00:01.000Z","sensor_ms":0}',
        b'{"type":"touch_began","touch":9007199254740993,"time":"2026-11-20T10:00:01.000Z","sensor_ms":0}',
    ],
)
def test_a_line_that_is_not_an_event_is_refused(line: bytes) -> None:
    with pytest.raises(EventError, match=r"not an event: .+"):
        decode(line)


def test_unknown_fields_of_a_later_version_are_ignored() -> None:
    line = encode(RobotEvent(state="up", time=TIME)).replace(b"}", b',"battery":0.5}')
    assert decode(line) == RobotEvent(state="up", time=TIME)


def test_times_are_utc_to_the_millisecond_and_read_back() -> None:
    assert timestamp(1795168800.0) == "2026-11-20T10:00:00.000Z"
    assert timestamp(1795168799.9996) == "2026-11-20T10:00:00.000Z"
    assert epoch_s("2026-11-20T10:00:00.125Z") == 1795168800.125


def words_of(hint: object) -> set[str]:
    return set(typing.get_args(hint))


def test_the_events_page_lists_exactly_the_existing_fields() -> None:
    page = (Path(__file__).parents[2] / "docs/events.md").read_text()
    kinds = typing.get_args(Event)
    fields = {field for kind in (*kinds, Feel) for field in kind.__struct_fields__}
    said = words_of(Stage) | words_of(EndReason) | words_of(PadState)
    tags = {str(kind.__struct_config__.tag) for kind in kinds}
    actions = words_of(typing.get_type_hints(RobotAction)["action"])
    everything = tags | fields | said | actions
    assert everything - set(re.findall(r"`(\w+)`", page)) == set()
    # The first column of the tables lists the names.
    first_column = " ".join(re.findall(r"^\| (`.*?) \|", page, re.M))
    assert set(re.findall(r"`([a-z_]+)`", first_column)) - everything == set()


def metadata(name: str, labels: list[str]) -> ModelMetadata:
    """Return metadata as read from a model file; raises msgspec.ValidationError."""
    others: dict[str, object] = {"frame_rate_hz": 54, "framing": "live", "lengths": [144], "max_length": 144}
    others |= {"temperatures": {}, "training": {}, "code_version": "", "data_sha256": "", "scores": {}}
    return msgspec.convert({"name": name, "labels": labels, **others}, ModelMetadata)


@pytest.mark.parametrize(
    "reason", ['"' * 5000, "\n\x00\x1b" * 5000, "\\" * 5000, "\U0001f44b" * 5000, "é" * 5000]
)
def test_a_reason_is_one_short_line(reason: str) -> None:
    said = one_line(reason, MAX_REASON_BYTES)
    assert said.isprintable()
    for kind in (SensorEvent, RobotEvent):
        event = kind(state="down", time=TIME, reason=said)
        assert decode(encode(event)) == event


def test_a_model_with_long_or_odd_names_is_refused() -> None:
    metadata("n" * 64, [f"{number:02}" + "l" * 22 for number in range(12)])
    for name, labels in (("n" * 65, ["a"]), ("n", ["l" * 25]), ("n", ["a"] * 13), ("é", ["a"]), ("n", ['"'])):
        with pytest.raises(msgspec.ValidationError):
            metadata(name, labels)
