"""Checks of the model and the robot."""

import re
import threading
import timeit
from collections.abc import Callable, Sequence
from contextlib import suppress

import numpy as np

from touchd.daemon.app.config import ConfigError, Settings
from touchd.daemon.app.parts import load_model
from touchd.daemon.doctor.check import Check
from touchd.drivers import hosts
from touchd.drivers.errors import PathError
from touchd.drivers.frame import COLUMNS, ROWS
from touchd.drivers.installed import program_name
from touchd.drivers.robot.link import ADVICE, client_of
from touchd.drivers.robot.session import PORTS as ROBOT_PORTS
from touchd.drivers.robot.session import RobotError, RobotLimits, RobotLost, RobotRefused, RobotSettings
from touchd.drivers.robot.wire import encrypted
from touchd.model.classifier import ModelError

# An answer must not take longer than a frame.
SLOW_ANSWER_MS = 18.5
TIMED_ANSWERS = 5
REACH_S = 2.0


def check_model(settings: Settings) -> Check:
    """Load the model as the daemon does, and time its longest answer."""
    try:
        classifier = load_model(settings)
    except (ModelError, PathError, ConfigError) as error:
        shipped = "leave model out of the settings to use the shipped one"
        return Check("model", "to do", str(error), "" if isinstance(error, ConfigError) else shipped)
    frames = settings.scene.answer_at_frames[-1]
    window = np.zeros((frames, ROWS, COLUMNS), dtype=np.float32)
    took_s = timeit.repeat(lambda: classifier.probabilities(window), number=1, repeat=TIMED_ANSWERS)
    answer_ms = 1000 * float(np.median(took_s))
    found = f"{classifier.name}, {len(classifier.labels)} gestures, answers in {answer_ms:.1f} ms"
    if answer_ms > SLOW_ANSWER_MS:
        return Check("model", "warning", f"{found}: a slow or busy machine, answers come late")
    return Check("model", "ok", found)


def robot_urls(typed: str) -> Sequence[str]:
    """Return the addresses that a robot's name, IP address or URL may mean, the likeliest first.

    Raises RobotError.
    """
    scheme, _, rest = typed.strip().rpartition("://")
    if rest.count(":") > 1 and "[" not in rest:
        rest = f"[{rest}]"
    host, port = re.fullmatch(r"(\[.*\]|[^:]*)(?::(.*))?", rest, re.DOTALL).groups()  # type: ignore[union-attr]
    scheme = scheme.lower()
    urls = [f"{scheme}://{host}:{port or ROBOT_PORTS.get(scheme, '')}".rstrip(":")] if scheme else []
    urls += [f"{each}://{host}:{port}" for each in ROBOT_PORTS if port]
    urls += [f"{each}://{host}:{usual}" for each, usual in ROBOT_PORTS.items()]
    try:
        for url in urls:
            RobotSettings(url=url)
    except ValueError as error:
        raise RobotError(str(error)) from error
    return list(dict.fromkeys(urls))


def find_robot(urls: Sequence[str], trying: Callable[[str], None]) -> str | None:
    """Return the first of several addresses at which a robot answers, if any.

    trying: called with each address before it is tried.
    """
    for url in urls:
        trying(url)
        with suppress(RobotError, RobotLost, RobotRefused):
            if certificate_at(url) if url.startswith("tcps://") else _ask_version(RobotSettings(url=url)):
                return url
    return None


def certificate_at(url: str) -> str | None:
    """Return the fingerprint of a robot's certificate, None if it does not answer with TLS.

    Before its login a robot reveals nothing else.
    """
    _, host, port = RobotSettings(url=url).address

    def give_up() -> None:
        raise TimeoutError

    with suppress(OSError), hosts.connect(host, port, REACH_S) as plain:
        tls, shown = encrypted(plain, give_up)
        tls.close()
        return shown
    return None


def check_robot(settings: Settings) -> Check:
    """Connect to the configured robot and ask for its version, within a few seconds."""
    wanted = settings.robot
    if wanted is None:
        return Check("robot", "ok", "none is configured")
    shown = certificate_at(wanted.url) if wanted.address[0] == "tcps" else None
    pin = f"if it is your robot, set robot.certificate: {shown}" if shown and wanted.pinned is None else ""
    try:
        version = _ask_version(wanted)
    except (RobotError, PathError) as error:
        wire = f"{program_name()} docs install says how to wire a robot"
        return Check("robot", "to do", str(error), pin or wire)
    except (RobotLost, RobotRefused) as error:
        if shown and not wanted.token_file:
            login = f"set robot.token_file ({program_name()} docs install)"
            found = f"{wanted.url} answers, and probably asks for a login ({error})"
            return Check("robot", "to do", found, f"{login}{pin and f'; {pin}'}")
        return Check("robot", "to do", f"{wanted.url}: {error}", f"ping it; {ADVICE}")
    return Check("robot", "ok", f"NAOqi {version} at {wanted.url}", pin)


def _ask_version(wanted: RobotSettings) -> str:
    """Return the robot's version."""
    limits = RobotLimits()
    session = client_of(wanted)(wanted, limits, threading.Event())
    try:
        session.connect()
        return str(session.call("ALSystem", "systemVersion", limit_s=limits.call_s))
    finally:
        session.close()
