"""`touchd init`: finds the pad, asks for the robot, tries both, and writes a working configuration."""

import argparse
import json
import shlex
import sys
import time
from collections.abc import Callable, Sequence
from pathlib import Path

from rich.console import Console
from serial.tools.list_ports import comports

from touchd.daemon.config import DEFAULT_PORT, ConfigError, load
from touchd.daemon.doctor.line import USUAL_BAUDS
from touchd.daemon.doctor.listening import listen
from touchd.daemon.doctor.machine import check_robot
from touchd.daemon.terminal.own_name import own_name
from touchd.drivers.errors import os_errors_as
from touchd.drivers.numbers import within
from touchd.drivers.pad.diagnosis import (
    RECENT_BYTES,
    as_yaml,
    caution,
    diagnose,
    has_single_bits,
    is_certain,
    propose,
)
from touchd.drivers.pad.format import PRESETS, PadFormat
from touchd.drivers.pad.port import Line, SensorError, at_baud, open_port, read_waiting
from touchd.drivers.pad.protocol import parser_of
from touchd.drivers.robot.settings import RobotError, RobotSettings, read_login
from touchd.drivers.whole_file import whole_file

# Opening the port restarts an Arduino, whose boot loader takes two seconds.
FIRST_BYTE_S = 3.0
LISTEN_S = 1.0
ANSWER_S = 0.5

Found = tuple[str, int, PadFormat]
"""A port, its baud rate, and the pad there."""


def parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="touchd init",
        description="Looks for a pad on this computer's ports, tries the robot, and writes a configuration.",
    )
    parser.add_argument("file", nargs="?", type=Path, default=Path("touchd.yaml"), help="(%(default)s)")
    parser.add_argument("--port", help="the pad's port or address, instead of looking for it")
    parser.add_argument(
        "--baud",
        type=within(int, 1200, 4_000_000),
        help="the pad's baud rate, instead of trying the usual ones",
    )
    parser.add_argument("--robot", metavar="URL", help="such as tcp://nao.local:9559, or none")
    return parser


def main(arguments: Sequence[str]) -> int:
    """Write the file and say what next; returns 0 when pad and robot answered, else 1."""
    options = parser().parse_args(arguments)
    if options.file.exists():
        raise ConfigError(f"{options.file} is there already; give another name, or move it away")
    file = shlex.quote(str(options.file))
    console = Console(stderr=True, highlight=False, markup=False, soft_wrap=True)
    ports = [options.port] if options.port else _ports()
    bauds = [options.baud] if options.baud else list(USUAL_BAUDS)
    found = _find(console, ports, bauds)
    port, baud, described = found or (options.port or DEFAULT_PORT, bauds[0], None)
    robot = _ask_robot(console) if options.robot is None else options.robot
    robot = None if robot in ("", "none") else robot
    described_as = as_yaml(described or PRESETS["fabric-grid"])
    text = f"sensor:\n  port: {_quoted(port)}\n  baud: {baud}\n  {described_as}\n"
    text += f"robot: {f'{{url: {_quoted(robot)}}}' if robot else 'null'}\njournal: {{}}\n"
    with (
        os_errors_as(ConfigError, f"{options.file}: cannot be written", "give another path"),
        whole_file(options.file, replace=False) as new,
    ):
        new.write_text(text, encoding="utf-8")
    settings = load(options.file)
    later = f"none found; once it can be opened, {own_name()} doctor -c {file} says what to set"
    console.print(f"pad: {described}, at {port}" if described else f"pad: {later}")
    if described and (check_it := caution(described)):
        console.print(f"{file}: {check_it}", style="yellow")
    is_well = described is not None
    if robot:
        check = check_robot(settings)
        console.print(f"robot: {check.found}{check.advice and f'; {check.advice}'}")
        is_well &= check.verdict == "ok"
    console.print(f"wrote {file}; next: {own_name()} doctor -c {file}, then {own_name()} run -c {file}")
    return 0 if is_well else 1


def _quoted(text: str) -> str:
    return json.dumps(text, ensure_ascii=False)


def _ports() -> list[str]:
    found = sorted(port.device for port in comports())
    if not Path(DEFAULT_PORT).exists():
        return found
    linked = str(Path(DEFAULT_PORT).resolve())
    return [DEFAULT_PORT, *(port for port in found if port != linked)]


def _find(console: Console, ports: Sequence[str], bauds: Sequence[int]) -> Found | None:
    """Return the first port with a pad. Only where no pad sends by itself are silent ports asked."""
    silent: list[str] = []
    for port in ports:
        if found := _listen(console, port, bauds, silent.append):
            return found
    return next(filter(None, (_listen(console, port, bauds) for port in silent)), None)


def _listen(
    console: Console, port: str, bauds: Sequence[int], on_silence: Callable[[str], None] | None = None
) -> Found | None:
    """Return what was heard at a port, None without a pad.

    on_silence: takes the port when it is silent, instead of asking there.
    """
    first_byte_s = FIRST_BYTE_S
    guesses: list[tuple[bool, int, PadFormat]] = []
    try:
        # The last is the slowest, which every adapter can do.
        with open_port(port, bauds[-1]) as opened:
            for baud in bauds if "://" not in port else bauds[:1]:
                console.print(f"listening to {port}{at_baud(port, baud)} ...")
                try:
                    opened.baudrate = baud
                except (OSError, ValueError):
                    continue
                opened.reset_input_buffer()
                data = _heard(opened, first_byte_s)
                # A pad that is silent at one baud rate is silent at all, but may answer a query.
                if not data and on_silence is not None:
                    on_silence(port)
                    return None
                described = propose(data) if data else _answering(opened)
                if described is not None and data and not is_certain(described):
                    guesses.append((has_single_bits(data), baud, described))
                elif described is not None:
                    if data and not parser_of(described).feed(data, 0.0):
                        console.print(diagnose(data, described)[1], style="yellow")
                    return port, baud, described
                first_byte_s = LISTEN_S if data else 0.0
    except (SensorError, OSError) as error:
        console.print(str(error), style="yellow")
    if not guesses:
        return None
    _, baud, described = max(guesses, key=lambda guess: guess[:2])
    if len(guesses) > 1:
        others = ", ".join(str(rate) for _, rate, _ in guesses if rate != baud)
        console.print(f"{baud} baud is a guess; it may be {others} too: --baud sets it", style="yellow")
    return port, baud, described


def _heard(opened: Line, first_byte_s: float) -> bytes:
    data = b""
    silent = parser_of(PRESETS["fabric-grid"])
    until_s = time.monotonic() + first_byte_s
    while time.monotonic() < until_s and len(data) < RECENT_BYTES:
        came = read_waiting(opened, silent)
        until_s = time.monotonic() + LISTEN_S if came and not data else until_s
        data += came
    return data


def _answering(opened: Line) -> PadFormat | None:
    """Return the preset whose query the pad answers, if any."""
    for described in (preset for preset in PRESETS.values() if preset.poll):
        heard = listen(opened, parser_of(described), ANSWER_S, start_s=ANSWER_S)
        if len(heard.frames) > 1 and not heard.damaged:
            return described
    return None


def _ask_robot(console: Console) -> str:
    """Return the address that is typed, "" without a terminal or at its end."""
    while sys.stdin.isatty():
        console.print("The robot's address, as in tcp://nao.local:9559 (Enter: no robot): ", end="")
        typed = sys.stdin.readline().strip()
        try:
            if typed not in ("", "none"):
                read_login(RobotSettings(url=typed))
            return typed
        except RobotError as error:
            console.print(str(error), style="yellow")
    return ""
