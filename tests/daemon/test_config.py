"""The configuration: each mistake is reported in one line that names it and says what to do."""

import errno
import re
from pathlib import Path
from typing import Any

import msgspec
import pytest

from touchd.daemon.app.config import (
    MAX_BYTES,
    ConfigError,
    JournalSettings,
    SensorSettings,
    Settings,
    config_errors,
    load,
)
from touchd.daemon.app.parts import make_parts
from touchd.daemon.app.strict_yaml import settings_in
from touchd.daemon.commands.settings import find_settings
from touchd.drivers.errors import PathError
from touchd.drivers.pad.format import PRESETS, SentFormat
from touchd.drivers.queue import Signal

EXAMPLE = Path(__file__).parents[2] / "daemon/touchd.example.yaml"


# The example with its commented-out settings enabled.
UNCOMMENTED = re.sub(r"^( *)#(- )?(\w+:)", r"\1\2\3", EXAMPLE.read_text(), flags=re.M)


def loaded(folder: Path, text: str | bytes) -> Settings:
    path = folder / "touchd.yaml"
    path.write_bytes(text.encode() if isinstance(text, str) else text)
    return load(path)


def refusal(folder: Path, text: str | bytes) -> str:
    with pytest.raises(ConfigError) as raised:
        loaded(folder, text)
    path, _, message = str(raised.value).partition(": ")
    assert path == str(folder / "touchd.yaml")
    assert "\n" not in message
    assert "s3cret" not in message
    return message


def test_without_a_home_the_daemon_runs_and_stores_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def unknown(_: int) -> None:
        raise KeyError

    # As a user without an entry in passwd, in a container.
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("pwd.getpwuid", unknown)
    for name in ("HOME", "XDG_CONFIG_HOME", "XDG_STATE_HOME", "STATE_DIRECTORY"):
        monkeypatch.delenv(name, raising=False)
    assert make_parts(find_settings(None).settings, print, tuple, Signal()).sinks == ()
    with pytest.raises(PathError, match="unknown home; set HOME, or write the whole path"):
        make_parts(Settings(journal=JournalSettings()), print, tuple, Signal())


def test_an_empty_file_is_all_defaults(tmp_path: Path) -> None:
    settings = loaded(tmp_path, "# nothing set\n")
    assert settings == Settings()
    assert settings.sensor.port == "/dev/touchd-pad"
    assert (settings.robot, settings.journal) == (None, None)


def test_every_line_of_the_example_can_be_used(tmp_path: Path) -> None:
    load(EXAMPLE)
    settings = loaded(tmp_path, re.sub(r"^robot: null\n", "", UNCOMMENTED, flags=re.M))
    assert settings.robot is not None
    assert settings.robot.token_file == "/etc/touchd/token"


def test_the_example_shows_the_defaults(tmp_path: Path) -> None:
    shown, default = loaded(tmp_path, UNCOMMENTED.split("# null: no robot")[0]), Settings()
    assert shown.touch == default.touch
    assert shown.sensor.described == default.sensor.described
    assert (shown.sensor.port, shown.sensor.baud) == (default.sensor.port, default.sensor.baud)
    for name in ("answer_at_frames", "early", "speak_above", "stale_s"):
        assert getattr(shown.scene, name) == getattr(default.scene, name)


def test_the_example_names_every_setting_outside_the_pads_format() -> None:
    of_format = {name for name, _ in settings_in(SentFormat)}
    named = {name.rpartition(".")[2] for name, _ in settings_in(Settings)} - of_format
    text = EXAMPLE.read_text()
    assert {name for name in named if not re.search(rf"\b{name}:", text)} == set()


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("sensr: {}", "sensr: unknown setting; did you mean sensor?"),
        ("sensor: {sensitivity: low}", "unknown setting; did you mean touch.sensitivity?"),
        ("sensor:\n\tport: x", "line 2, column 1: indent with spaces, not with tabs"),
        ("sensor: {format: {framing: txt}}", "sensor.format.framing: 'txt' is not one of text, binary"),
        ("robot: {ip: 10.0.0.5}", "robot.ip: unknown setting; there are robot.url, "),
        ("sensor: {'a`b': 1}", "sensor.a`b: unknown setting"),
        ("sensor: {baud: fast}", "sensor.baud: a whole number expected, not text"),
        ("sensor: {port: ''}", "sensor.port: must not be empty"),
        ("touch: {quiet_s: 800}", "touch.quiet_s: 800 must be at most 5 (seconds)"),
        ("scene: {speak_above: 1.01}", "scene.speak_above: 1.01 must be at most 1"),
        # A limit above zero would be a denormal number, which is zero once the model is loaded.
        ("scene: {stale_s: 0}", "scene.stale_s: 0 must be at least 0.001 (seconds)"),
        (
            "scene: {answer_at_frames: [0, 81, 144]}",
            "scene.answer_at_frames[0]: 0 must be at least 1 (frames)",
        ),
        ("sensors: {a: {size_mm: [0, 80]}}", "size_mm[0]: must be at least 0.001 (millimetres)"),
        (f"sensor: {{baud: {'9' * 8000}}}", "Exceeds the limit (4300 digits)"),
        ("sensor: {format: {header: aa, crop: 4}}", "10x10 with crop 4 leaves 2x2; a side of 4 to 64"),
        ("sensor: {format: fabricgrid}", "velostat, m1616; did you mean fabric-grid?"),
        ("sensor: {format: {header: aa, clock: true}}", "sensor.format.clock: "),
        ("sensor: {format: {framing: binary}}", "needs a header"),
        ("sensor: {format: {rows: 8, columns: 8}}", "lines of numbers need framing: text"),
        ("live:\n  #port: 8054", "line 1, column 1: live has no value; write null for none"),
        ("touch: {quiet_s: .nan}", "touch.quiet_s: nan must be at least 0.1"),
        ("mqtt: broker.local", "not text; as in mqtt: {host: broker.local}"),
        ("scene: {gestures: [3]}", "scene.gestures[0]: text (in quotes) expected, not a whole number"),
        (
            "touch: {sensitivity: 2}",
            "touch.sensitivity: one of low, normal, high expected, not a whole number",
        ),
        ("scene: {answer_at_frames: [81, 54, 144]}", "must rise from early to final"),
        ("robot: {}", "robot: url is missing"),
        ("scene: {actions: [{do: [{sai: a}]}]}", "scene.actions[0].do[0].sai: unknown setting; did you mean"),
        ("robot: {url: 'tcp://n:1', token: s3cret}", "robot.token: unknown setting; write the token"),
        ("mqtt: {host: 'mqtt://broker'}", "mqtt.host: another form expected, as in host: broker.local"),
        ("name: nao__1", "name: another form expected, as in name: lab/nao1"),
        ("mqtt: {discovery: a/#}", "mqtt.discovery: another form expected, as in discovery: homeassistant"),
        ("rosbridge: {url: 'ws://robot:90900'}", "(Port out of range 0-65535)"),
        ("scene: {actions: [{above: {peek: 3}, do: [{say: a}]}]}", "'peek' is not one of duration_s"),
        ("model: null\nmodel: x.onnx", "line 2, column 1: model is set twice"),
        ("model: a\n<<: {model: b}", "line 2, column 1: merge keys (<<) are not allowed"),
        ("sensor: [", "line 1, column 10: "),
        ("sensor:\n  port /dev/x\n  baud: 9600", "line 3, column 7: a colon where none can stand"),
        ("scene:\n  gestures:\n  - pat\n - rub", "line 4, column 2: indent this line as far as the other"),
        ("model: 'a\n", "line 2, column 1: a quote is opened above and not closed"),
        ("scene: {speak_above: 0,65}", "line 1, column 24: 65 has no value; write null for none, {} for"),
        ("scene: {answer_at_frames: [54, 81]}", "scene.answer_at_frames: 3 values expected, not 2"),
        ("[" * 600, "not YAML"),
        ("sensor: !!python/object/apply:os.system [ls]", "tags (!name) are not allowed"),
        ("model: 2020-99-99", "not YAML"),
        ("a: \x00", "line 1: special characters are not allowed"),
        ("sensor:\n\u00a0 port: a", "line 2 has an invisible character (U+00A0, perhaps copied from a page)"),
        (
            "scene: {actions: [{on: pat}]}",
            "scene.actions[0]: a name before a colon is not text; put it in quotes",
        ),
        ("rosbridge: {url: 'robot:9090'}", "another form expected, as in url: ws://robot:9090"),
        ("words: {pat: clap}", "not text; as in words: {stroke: {name: caress, phrase: a caress}}"),
        ("[sensor]\nport=a", "line 2, column 1: settings (name: value) expected"),
        ("lsl: true", "lsl: settings (name: value, or {}) or null expected, not true or false"),
        ("model: a\n---\nmodel: b", "line 2, column 1: one document expected; remove the line ---"),
        ("\n\n# Größe".encode("latin-1"), "line 3: invalid start byte; save the file as UTF-8 text"),
        pytest.param("#" * (MAX_BYTES + 1), "larger than 64 KiB", id="huge"),
    ],
)
def test_a_mistake_is_named_in_one_line(tmp_path: Path, text: str | bytes, message: str) -> None:
    assert message in refusal(tmp_path, text)


def test_a_missing_file_is_named(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"nowhere\.yaml: cannot be read \(No such file or directory\)"):
        load(tmp_path / "nowhere.yaml")


def test_a_file_of_nested_aliases_is_refused_at_once(tmp_path: Path) -> None:
    levels = ["&a [x, x, x, x, x, x, x, x, x]"]
    for one, two in zip("abcdefgh", "bcdefghi", strict=True):
        levels.append(f"&{two} [{', '.join([f'*{one}'] * 9)}]")
    message = refusal(tmp_path, f"model: [{', '.join(levels)}]")
    assert message == "line 1, column 45: aliases (*name) are not allowed; write the value out"


@pytest.mark.parametrize(
    ("sensor", "is_finer"),
    [
        ({}, False),
        ({"format": "velostat"}, False),
        ({"format": "m1616"}, True),
        ({"format": msgspec.structs.replace(PRESETS["m1616"], crop=4)}, False),
        ({"format": msgspec.structs.replace(PRESETS["velostat"], columns=9)}, True),
    ],
)
def test_a_finer_pad_is_recognised_by_its_grid(sensor: dict[str, Any], is_finer: bool) -> None:
    assert Settings(sensor=SensorSettings(**sensor)).pipeline.is_finer == is_finer


@pytest.mark.parametrize("lack", [MemoryError(), OSError(errno.EMFILE, "Too many open files")])
def test_a_lack_of_memory_is_not_a_configuration_error(lack: Exception) -> None:
    # A configuration error ends with exit code 2, after which systemd would not restart the service.
    with pytest.raises(type(lack)), config_errors():
        raise lack
    with pytest.raises(ConfigError, match="Too many levels"), config_errors():
        raise OSError(errno.ELOOP, "Too many levels of symbolic links")
