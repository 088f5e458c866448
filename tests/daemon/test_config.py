"""The configuration: each mistake is reported in one line that names it and says what to do."""

import re
from collections.abc import Iterator
from pathlib import Path

import pytest
from msgspec import inspect

from touchd.daemon.bridges.settings import LslSettings
from touchd.daemon.config import MAX_BYTES, ConfigError, Settings, load
from touchd.drivers.pad.format import PadFormat
from touchd.model.classifier import SHIPPED_MODEL, Classifier

EXAMPLE = Path(__file__).parents[2] / "systemd" / "touchd.example.yaml"


# Its settings that are commented out, taken in.
UNCOMMENTED = re.sub(r"^( *)#(- )?(\w+:)", r"\1\2\3", EXAMPLE.read_text(), flags=re.M)


def loaded(folder: Path, text: str) -> Settings:
    path = folder / "touchd.yaml"
    path.write_text(text)
    return load(path)


def refusal(folder: Path, text: str) -> str:
    with pytest.raises(ConfigError) as raised:
        loaded(folder, text)
    path, _, message = str(raised.value).partition(": ")
    assert path == str(folder / "touchd.yaml")
    assert "\n" not in message
    return message


def test_a_renamed_key_is_taken_with_one_warning(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    assert loaded(tmp_path, "touch: {onset_level: 6.0}\n").touch.onset_threshold == 6.0
    (record,) = caplog.records
    assert "touch.onset_level is now called touch.onset_threshold" in record.message


def test_an_empty_section_is_warned_of(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    assert loaded(tmp_path, "robot: null\nlive:\n  #port: 8054\nlsl: {}\n") == Settings(lsl=LslSettings())
    assert caplog.messages == ["configuration, line 2: live is empty, so not used; {} takes its defaults"]


def test_an_empty_file_is_all_defaults(tmp_path: Path) -> None:
    settings = loaded(tmp_path, "# nothing set\n")
    assert settings == Settings()
    assert settings.sensor.port == "/dev/touchd-pad"
    assert (settings.robot, settings.journal) == (None, None)


def test_every_line_of_the_example_can_be_used(tmp_path: Path) -> None:
    load(EXAMPLE)
    settings = loaded(tmp_path, re.sub(r"^(robot: null| *token_env:.*)\n", "", UNCOMMENTED, flags=re.M))
    assert settings.robot is not None
    assert settings.robot.token_file == "/etc/touchd/token"


def test_the_example_shows_the_defaults(tmp_path: Path) -> None:
    shown, default = loaded(tmp_path, UNCOMMENTED.split("# null: no robot")[0]), Settings()
    assert shown.touch == default.touch
    assert shown.sensor.described == default.sensor.described
    assert (shown.sensor.port, shown.sensor.baud) == (default.sensor.port, default.sensor.baud)
    for name in ("answer_at_frames", "speak_above", "revise_margin", "stale_s"):
        assert getattr(shown.scene, name) == getattr(default.scene, name)


def test_the_example_names_every_setting_but_those_of_a_pads_format() -> None:
    text, seen = EXAMPLE.read_text(), set()

    def names(kind: inspect.Type) -> Iterator[str]:
        match kind:
            case inspect.StructType(cls=cls, fields=fields) if cls is not PadFormat and cls not in seen:
                seen.add(cls)
                for field in fields:
                    yield field.encode_name
                    yield from names(field.type)
            case inspect.UnionType(types=several):
                for each in several:
                    yield from names(each)
            case inspect.ListType(item_type=inner) | inspect.VarTupleType(item_type=inner):
                yield from names(inner)
            case inspect.DictType(value_type=inner):
                yield from names(inner)

    # protocol: the old name of format.
    named = set(names(inspect.type_info(Settings))) - {"protocol"}
    assert {name for name in named if not re.search(rf"\b{name}:", text)} == set()


def test_a_file_in_another_encoding_is_told_with_its_line(tmp_path: Path) -> None:
    path = tmp_path / "touchd.yaml"
    path.write_bytes("sensor:\n  port: /dev/ttyACM0\n# Größe\n".encode("latin-1"))
    with pytest.raises(ConfigError, match="line 3: invalid start byte; save the file as UTF-8 text"):
        load(path)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("sensr: {}", "sensr is not a setting; did you mean sensor?"),
        ("sensor: {prt: /dev/x}", "sensor.prt is not a setting; did you mean port?"),
        ("sensor: {onset_threshold: 5}", "sensor.onset_threshold is not a setting; it belongs under touch:"),
        ("rows: 10", "rows is not a setting; it belongs under sensor:"),
        ("scene: {zzz: 1}", "scene.zzz is not a setting; known here: gestures"),
        ("sensor: {baud: fast}", "sensor.baud must be a whole number, not 'fast'"),
        ("sensor: {port: ''}", "sensor.port must be text of length >= 1, not ''"),
        ("sensor: {baud: 3}", "sensor.baud must be a whole number >= 1200, not 3"),
        ("sensor: {invert: maybe}", "sensor.invert must be true or false or null, not 'maybe'"),
        ("sensor: {protocol: cvs}", "sensor.protocol must be fabric-grid or csv, not 'cvs'"),
        ("sensor: {crop: 4}", "10x10 with crop 4 leaves 2x2; a side of 4 to 64 must be left"),
        ("sensor: {format: mucha}", "format 'mucha' is none of fabric-grid, csv,"),
        ("sensor: {format: {framing: binary}}", "needs a header, a footer or a poll"),
        ("sensor: {format: {headr: aa}}", "sensor.format.headr is not a setting; did you mean header?"),
        ("sensor:", "sensor is empty; give it a value, or leave it out"),
        ("touch: {onset_level: 4, onset_threshold: 5}", "touch.onset_level is not a setting"),
        ("touch: {onset_threshold: .nan}", "touch.onset_threshold must be a number >= 0.001, not nan"),
        ("scene: {speak_above: 1.5}", "scene.speak_above must be a number <= 1.0, not 1.5"),
        ("scene: {gestures: [3]}", "scene.gestures must be text, not 3; put it in quotes"),
        ("scene: {answer_at_frames: [81, 54, 144]}", "must rise from early to final"),
        ("robot: {}", "robot.url is missing and has no default"),
        ("scene: {actions: [{do: [{sai: a}]}]}", "scene.actions.do.sai is not a setting; did you mean say?"),
        ("scene: {actions: [{stages: [fin], do: []}]}", "scene.actions.stages must be early or revised or"),
        ("scene: {actions: [{do: [{say: '{who}'}]}]}", "may hold {gesture}, {name}, {phrase} and"),
        ("robot: {url: 'tcp://nao:9559', prefix: ALTouch}", "does not begin with AL"),
        ("robot: {url: 'tcp://n:1', token_file: a, token_env: B}", "token_file and token_env are both set"),
        ("journal: {path: x, max_mb: .inf}", "journal.max_mb must be a number <= 10000.0, not inf"),
        ("mqtt: {topic: a/#}", "mqtt.topic must be text such as touchd, not 'a/#'"),
        ("mqtt: {discovery: +}", "mqtt.discovery must be text in another form, not '+'"),
        ("rosbridge: {url: 'http://x'}", "rosbridge.url must be text such as ws://localhost:9090, not"),
        ("rosbridge: {url: 'ws://robot:90900'}", "is no address (Port out of range 0-65535)"),
        (
            "scene: {actions: [{above: {peak: x}, do: [{say: a}]}]}",
            "actions.above.peak must be a number, not 'x'",
        ),
        ("scene: {actions: [{above: {peek: 3}, do: [{say: a}]}]}", "rhythm_hz, not ['peek']"),
        ("scene: {actions: [{above: {peak: .nan}, do: [{say: a}]}]}", "actions.above.peak must be a number"),
        ("touch: {settled_s: 20}", "touch.settled_s is not a setting"),
        ("log_level: loud", "log_level must be debug or info or warning or error, not 'loud'"),
        ("model: null\nmodel: x.onnx", "line 2: model is set twice"),
        ("sensor: [", "line 1, column 10: "),
        ("sensor: {port: x\nmodel: y", "a comma or a closing bracket is missing"),
        ("model: a: b", "line 1, column 9: a colon too many, or a wrong indentation"),
        ("sensor:\n\tport: x", "line 2, column 1: tabs and characters such as @"),
        ("[" * 20_000, "not YAML"),
        ("just words", "the file must be a section of settings, not 'just words'"),
        ("? [1, 2]\n: 3", "line 1: found unhashable key"),
        ("sensor: !!python/object/apply:os.system [ls]", "could not determine a constructor"),
        ("model: 2020-99-99", "not YAML"),
        ("a: \x00", "not YAML"),
        ("1: 2", "a name in the file must be text, not [1]"),
    ],
)
def test_a_mistake_is_named_in_one_line(tmp_path: Path, text: str, message: str) -> None:
    assert message in refusal(tmp_path, text)


@pytest.mark.parametrize(
    "text",
    ["scene: {stale_s: 0}", "journal: {max_mb: 0}", "mqtt: {pressure_hz: 0}", "sensor: {size_mm: [0, 8]}"],
)
def test_zero_is_refused_after_the_model_is_loaded(tmp_path: Path, text: str) -> None:
    Classifier.load(SHIPPED_MODEL)
    assert "must be a number >= 0.001" in refusal(tmp_path, text)


def test_a_missing_file_is_named(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"nowhere\.yaml: cannot be read \(No such file or directory\)"):
        load(tmp_path / "nowhere.yaml")


def test_a_huge_file_is_refused_unread(tmp_path: Path) -> None:
    assert "larger than 64 KiB" in refusal(tmp_path, "#" * (MAX_BYTES + 1))


def test_a_file_of_nested_aliases_is_refused_at_once(tmp_path: Path) -> None:
    levels = ["&a [x, x, x, x, x, x, x, x, x]"]
    for one, two in zip("abcdefgh", "bcdefghi", strict=True):
        levels.append(f"&{two} [{', '.join([f'*{one}'] * 9)}]")
    message = refusal(tmp_path, f"model: [{', '.join(levels)}]")
    assert message == "line 1: aliases (*name) are not taken; write the value out"
