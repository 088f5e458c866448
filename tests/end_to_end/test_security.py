"""External input is only data: nothing listens, nothing is executed, everything is bounded."""

import ast
import json
import os
import socket
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
import yaml
from rigs.programs import TOUCHD, Program
from rigs.running_daemon import Daemon
from rigs.sockets import LISTENS, LOOPBACK, sockets
from rigs.wait import wait_for

from touchd.daemon.app.config import JournalSettings
from touchd.daemon.app.strict_yaml import StrictLoader
from touchd.daemon.path.events import RobotEvent, SensorEvent
from touchd.drivers.robot.session import RobotSettings
from touchd.model.training.recipe import MAX_BYTES, SettingsError, read_recipe

ROOT = Path(__file__).parents[2]
SOURCES = sorted(path for floor in ("daemon", "drivers", "model") for path in (ROOT / floor).rglob("*.py"))
# Modules that execute their input.
RUNS_WHAT_IT_READS = {"pickle", "cPickle", "_pickle", "dill", "cloudpickle", "joblib", "shelve", "marshal"}


def dangers(source: str) -> Iterator[str]:
    """Yield the calls and imports in a source file that could execute their input."""
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Import):
            yield from (name.name for name in node.names if name.name.split(".")[0] in RUNS_WHAT_IT_READS)
        elif isinstance(node, ast.ImportFrom) and (node.module or "").split(".")[0] in RUNS_WHAT_IT_READS:
            yield node.module or ""
        elif isinstance(node, ast.Call):
            called = ast.unparse(node.func)
            given = {
                keyword.arg: ast.unparse(keyword.value)
                for keyword in node.keywords
                if keyword.arg in ("shell", "weights_only", "allow_pickle")
            }
            if called in ("eval", "exec", "os.system", "os.popen") or given.get("shell") == "True":
                yield called
            if called == "torch.load" and given.get("weights_only") != "True":
                yield "torch.load without weights_only"
            if called in ("np.load", "numpy.load") and given.get("allow_pickle", "False") != "False":
                yield "np.load with allow_pickle"
            loads_yaml = called in ("yaml.load", "yaml.unsafe_load", "yaml.full_load", "yaml.load_all")
            if loads_yaml and "StrictLoader" not in ast.unparse(node):
                yield called


@pytest.mark.parametrize(
    "source",
    [
        "import pickle",
        "from joblib import load",
        "torch.load(path)",
        "torch.load(path, weights_only=False)",
        "np.load(path, allow_pickle=True)",
        "yaml.unsafe_load(text)",
        "subprocess.run(command, shell=True)",
        "eval(text)",
    ],
)
def test_code_that_runs_its_input_is_detected(source: str) -> None:
    assert list(dangers(source))


def test_no_source_runs_its_input() -> None:
    assert len(SOURCES) > 50
    found = {str(path.relative_to(ROOT)): list(dangers(path.read_text())) for path in SOURCES}
    # Its process reads what the daemon wrote to its standard input, and nothing else.
    assert found.pop("daemon/bridges/process.py") in ([], ["pickle"])
    assert {path: calls for path, calls in found.items() if calls} == {}


def test_the_configurations_loader_creates_no_objects() -> None:
    assert issubclass(StrictLoader, yaml.SafeLoader | yaml.CSafeLoader)


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"#" * (MAX_BYTES + 1), "larger than 64 KiB"),
        (b"\xff\xfe\xfd: [", "recipe.yaml: "),
        (b"name: [", "recipe.yaml: while parsing"),
    ],
)
def test_an_invalid_recipe_is_refused_in_one_line(tmp_path: Path, content: bytes, message: str) -> None:
    path = tmp_path / "recipe.yaml"
    path.write_bytes(content)
    with pytest.raises(SettingsError, match=message) as refusal:
        read_recipe(path)
    assert "\n" not in str(refusal.value)


def test_a_listening_socket_is_detected() -> None:
    with socket.create_server(("127.0.0.1", 0)):
        assert ("tcp", LISTENS) in [(protocol, state) for protocol, _, state in sockets(os.getpid())]


def test_the_models_runtime_sends_no_telemetry(tmp_path: Path) -> None:
    # It sends from a database in the home folder, and stays silent if it detects a test.
    silent_for_tests = ("ORT_DISABLE_TELEMETRY", "ORT_RUNNING_UNIT_TESTS", "CI", "GITHUB_ACTIONS")
    environment = {name: value for name, value in os.environ.items() if name not in silent_for_tests}
    load = "from touchd.daemon.app.parts import load_models, Settings; load_models(Settings())"
    environment |= {"HOME": str(tmp_path), "XDG_CACHE_HOME": str(tmp_path)}
    subprocess.run([sys.executable, "-c", load], env=environment, check=True, timeout=25)
    assert list(tmp_path.rglob("*")) == []


def test_the_daemon_listens_nowhere(tmp_path: Path) -> None:
    with (
        Program(*TOUCHD, "fake-robot", "--port", "0") as robot,
        Daemon(
            tmp_path,
            robot=RobotSettings(url=json.loads(robot.stdout.readline())["listening"]),
            journal=JournalSettings(path=str(tmp_path / "events.jsonl")),
        ) as daemon,
    ):
        wait_for(lambda: {SensorEvent, RobotEvent} <= set(map(type, daemon.events)))
        daemons, robots = sockets(daemon.process.pid), sockets(robot.pid)
        assert daemon.stop() == 0
        robot.terminate()
    assert [one for one in daemons if one[2] == LISTENS or one[0].startswith("udp")] == []
    assert {address.partition(":")[0] for _, address, _ in daemons + robots} == {LOOPBACK}
    assert LISTENS in [state for _, _, state in robots]
