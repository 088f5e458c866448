"""Fixtures for tests of every folder."""

import gc
import logging
import os
import signal
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

# Several workers share the cores; more than one thread of torch or numpy in each would only wait.
os.environ.setdefault("OMP_NUM_THREADS", "1")
# Otherwise commands would find the configuration of the person who runs the tests.
os.environ["XDG_CONFIG_HOME"] = "/nonexistent"
# Nor may they write what the daemon remembers into that person's home.
os.environ["XDG_STATE_HOME"] = str(Path(tempfile.gettempdir()) / f"touchd-tests-state-{os.getuid()}")
os.environ["XDG_RUNTIME_DIR"] = os.environ["XDG_STATE_HOME"]

import pytest
from xdist.scheduler import LoadFileScheduling

from touchd.model.classifier import SHIPPED_MODEL, Classifier

if TYPE_CHECKING:
    from rigs.live_rig import Served
    from selenium.webdriver import Chrome

# Keep bytecode: without it, each worker and each program that a test starts would compile every file.
sys.dont_write_bytecode = False
os.environ.pop("PYTHONDONTWRITEBYTECODE", None)
# Imported modules and collected tests are never freed; searching them for garbage takes a quarter of the time
# in which pytest collects the tests.
gc.disable()
# Triton, which comes with torch for GPUs, would report what it leaks after pytest's last line.
sys.modules["triton"] = None  # type: ignore[assignment]
# Programs that tests start inherit ignored signals: Ctrl-C from a shell's background, SIGHUP from nohup.
signal.signal(signal.SIGINT, signal.default_int_handler)
signal.signal(signal.SIGHUP, signal.SIG_DFL)

# Training or exporting a network imports torch's compiler, which takes as long as torch itself: one worker
# does all of it.
TRAINING = (
    "test_adapt.py",
    "test_tgc.py",
    "test_detector.py",
    "test_challenge.py",
    "test_train.py",
    "test_speed.py",
    "test_paper.py",
)
# These share a browser, which takes a processor's seconds to start.
BROWSING = ("test_live_page.py", "test_live_touch.py")
# The slowest files, slowest first: if they started last, one worker would finish late.
LONGEST = (
    *BROWSING,
    *TRAINING,
    "test_init.py",
    "test_end_to_end.py",
    "test_bridges.py",
    "test_sensor.py",
    "test_search.py",
    "test_robot.py",
    "test_foreign_pads.py",
    "test_hostile_peers.py",
    "test_service.py",
    "test_robot_wire.py",
)


def pytest_configure() -> None:
    os.makedirs(os.environ["XDG_RUNTIME_DIR"], mode=0o700, exist_ok=True)


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Run the slowest files first."""
    items.sort(key=lambda item: LONGEST.index(item.path.name) if item.path.name in LONGEST else len(LONGEST))


@pytest.hookimpl(trylast=True)
def pytest_collection_finish() -> None:
    """Enable garbage collection from here on, for the objects that tests make."""
    gc.freeze()
    gc.enable()


class ByFile(LoadFileScheduling):
    """Gives each file to one worker; all files that train networks, and all that browse, to the same one."""

    def _split_scope(self, nodeid: str) -> str:
        file = super()._split_scope(nodeid)
        name = file.rpartition("/")[2]
        return "training" if name in TRAINING else "browsing" if name in BROWSING else file


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_make_scheduler(config: pytest.Config, log: Any) -> ByFile:
    return ByFile(config, log)


@pytest.fixture(autouse=True)
def own_signals() -> Iterator[None]:
    """Undo what a command that runs in this process does to signals: programs inherit ignored ones."""
    numbers = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
    before = [signal.getsignal(number) for number in numbers]
    yield
    for number, handler in zip(numbers, before, strict=True):
        signal.signal(number, handler)


@pytest.fixture(autouse=True)
def own_log_levels() -> Iterator[None]:
    """Undo what tests do to the levels of the logs: the next one would see other lines than alone."""
    # A module's fixtures run before this one, and may run a command that says more.
    logging.getLogger().setLevel(logging.WARNING)
    loggers = [logging.getLogger()]
    loggers += [log for log in logging.Logger.manager.loggerDict.values() if isinstance(log, logging.Logger)]
    before, disabled = [log.level for log in loggers], logging.root.manager.disable
    yield
    logging.disable(disabled)
    for log in logging.Logger.manager.loggerDict.values():
        if isinstance(log, logging.Logger) and log not in loggers:
            log.setLevel(logging.NOTSET)
    for log, level in zip(loggers, before, strict=True):
        log.setLevel(level)


@pytest.fixture(scope="session")
def classifier() -> Classifier:
    """The shipped model."""
    return Classifier.load(SHIPPED_MODEL)


@pytest.fixture(scope="session")
def own_chrome() -> Iterator["Chrome"]:
    """A browser for all tests of a worker."""
    from rigs.browser import CHROMIUM, DRIVER, browser

    if CHROMIUM is None or DRIVER is None:
        pytest.skip("chromium and chromium-driver are not installed")
    with browser() as chrome:
        yield chrome


@pytest.fixture(scope="module")
def chrome(own_chrome: "Chrome") -> Iterator["Chrome"]:
    """The worker's browser, left on an empty page: another would go on drawing and reconnecting."""
    yield own_chrome
    own_chrome.get("about:blank")


@pytest.fixture
def served() -> Iterator["Served"]:
    """A live page, served in this process."""
    from rigs.live_rig import serving

    with serving() as served:
        yield served


@pytest.fixture(scope="module")
def one_thread() -> Iterator[None]:
    """Run torch on one thread, so that its sums are reproducible."""
    from touchd.model.adapt.head import one_torch_thread

    with one_torch_thread():
        yield
