"""`touchd init`: finds the pad, asks for the robot, tries both, and writes a working configuration."""

import argparse
import json
import os
import shlex
import sys
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import NamedTuple

from rich.console import Console
from serial.tools.list_ports import comports

from touchd.daemon.app.config import DEFAULT_PORT, ConfigError, SensorSettings, Settings, load
from touchd.daemon.app.parts import check_pad
from touchd.daemon.doctor.hand import (
    LISTEN_S,
    add_grid,
    can_ask,
    find_with_a_hand,
    find_without_asking,
    turned_with_a_hand,
)
from touchd.daemon.doctor.machine import certificate_at, check_robot, find_robot, robot_urls
from touchd.daemon.doctor.port import advice_for, lasting_name
from touchd.drivers.errors import os_errors_as, within
from touchd.drivers.installed import program_name
from touchd.drivers.pad.format import PadFormat
from touchd.drivers.pad.port import Port, SensorError, at_baud, open_port
from touchd.drivers.robot.session import RobotError
from touchd.drivers.search.listen import USUAL_BAUDS, Chunk, likeliest_baud
from touchd.drivers.search.search import Grid, as_yaml
from touchd.drivers.whole_file import whole_file

DESCRIPTION = (
    "Looks for a pad on this computer's ports, tries the robot, and writes a configuration. "
    "In a terminal it asks for the pad's rows and columns and for presses; otherwise give --grid, and "
    f"press the pad while it listens for {LISTEN_S:g} s. Exit code 0: pad and robot answered; 1: not; "
    "2: wrong options."
)

_quoted = partial(json.dumps, ensure_ascii=False)


class Found(NamedTuple):
    """A port, its baud rate, and the pad there; None if its bytes are not understood."""

    port: str
    baud: int
    described: PadFormat | None


def add_options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("file", nargs="?", type=Path, default=Path("touchd.yaml"), help="(%(default)s)")
    parser.add_argument("--port", help="the pad's port or address, instead of looking for it")
    parser.add_argument(
        "--baud",
        type=within(int, 1200, 4_000_000),
        help="the pad's baud rate, instead of trying the usual ones",
    )
    add_grid(parser)
    parser.add_argument(
        "--robot", metavar="ADDRESS", help="the robot's name or address, such as nao.local, or none"
    )


def main(options: argparse.Namespace) -> int:
    """Write the file and print the next steps; returns 0 when pad and robot answered, else 1."""
    _check(options)
    console = Console(stderr=True, highlight=False, markup=False, soft_wrap=True)
    found, touchd = _find(console, options), program_name()
    if found is not None and found.described is None:
        how = f"no configuration was written; how to describe a pad: {touchd} docs pads"
        console.print(how, style="bold")
        return 1
    # Without a pad, assume a fabric pad. Its baud rate is not the first of the usual ones.
    assumed = SensorSettings()
    port, baud, described = found or Found(options.port or assumed.port, options.baud or assumed.baud, None)
    name, why = lasting_name(port)
    urls = _ask_robot(console) if options.robot is None else _urls_of_robot(options.robot)
    robot = find_robot(urls, lambda url: console.print(f"trying {url} ...")) or next(iter(urls), None)
    certificate = certificate_at(robot) if robot and robot.startswith("tcps://") else None
    _write(options.file, name, baud, described or assumed.described, robot, certificate)
    file = shlex.quote(str(options.file))
    later = f"none found, so {file} describes a fabric pad; for another, plug it in, delete {file} and repeat"
    console.print(f"pad: {described}, at {name} ({why})" if described else f"pad: {later}")
    is_well = described is not None
    if robot:
        check = check_robot(load(options.file))
        console.print(f"robot: {check.found}{check.advice and f'; {check.advice}'}")
        if certificate:
            console.print(f"from now on, only this robot is trusted (robot.certificate): {certificate}")
        is_well &= check.verdict == "ok"
    console.print(f"wrote {file}; next: {touchd} doctor -c {file}, then {touchd} run -c {file}")
    return 0 if is_well else 1


def _check(options: argparse.Namespace) -> None:
    """Refuse wrong options before somebody presses the pad for nothing."""
    if options.file.exists():
        raise ConfigError(f"{options.file} is there already; give another name, or move it away")
    if not os.access(options.file.absolute().parent, os.W_OK | os.X_OK):
        raise ConfigError(
            f"{options.file}: cannot be written (no such folder, or no permission); give another path"
        )
    _urls_of_robot(options.robot or "")
    if options.port:
        check_pad(Settings(sensor=SensorSettings(port=options.port)))


def _write(
    file: Path, port: str, baud: int, described: PadFormat, robot: str | None, certificate: str | None
) -> None:
    """Write the configuration, and check that it can be loaded."""
    lines = ["sensor:", f"  port: {_quoted(port)}", f"  baud: {baud}", f"  {as_yaml(described)}"]
    lines += [f"  turn: {described.turn}"] if described.turn else []
    lines += ["  mirror: true"] if described.mirror else []
    pinned = f", certificate: {_quoted(certificate)}" if certificate else ""
    lines += [f"robot: {f'{{url: {_quoted(robot)}{pinned}}}' if robot else 'null'}", "journal: {}", ""]
    with (
        os_errors_as(ConfigError, f"{file}: cannot be written", "give another path"),
        whole_file(file, replace=False) as new,
    ):
        new.write_text("\n".join(lines), encoding="utf-8")
    load(file)


def _ports() -> list[str]:
    found = sorted(port.device for port in comports())
    if not Path(DEFAULT_PORT).exists():
        return found
    linked = str(Path(DEFAULT_PORT).resolve())
    return [DEFAULT_PORT, *(port for port in found if port != linked)]


def _find(console: Console, options: argparse.Namespace) -> Found | None:
    """Return the first port with a pad, else the first that sends anything; None if none does.

    Raises SensorError if none sends and one is forbidden or busy: the pad may be there.
    """
    unknown: Found | None = None
    closed: list[SensorError] = []
    bauds = [options.baud] if options.baud else USUAL_BAUDS
    for port in [options.port] if options.port else _ports():
        try:
            found = _listen(console, port, bauds if "://" not in port else bauds[:1], options.grid)
        except SensorError as error:
            if error.kind in ("denied", "busy"):
                closed.append(SensorError(error.kind, f"{error}; {advice_for(port, error)}"))
            else:
                console.print(str(error), style="yellow")
            continue
        if found is not None and found.described is not None:
            return found
        unknown = unknown or found
    if unknown is None and closed:
        raise closed[0]
    for each in closed:
        console.print(str(each), style="yellow")
    return unknown


def _listen(console: Console, port: str, bauds: Sequence[int], grid: Grid | None) -> Found | None:
    """Return the pad or other sender at a port, None if nothing arrives; raises SensorError."""
    tried: list[int] = []

    def trying(baud: int) -> None:
        tried.append(baud)
        count = f" ({len(tried)} of {len(bauds)} rates)" if len(bauds) > 1 else ""
        # One line that counts; without a terminal, the first one stays.
        if console.is_terminal or len(tried) == 1:
            console.print(f"\rlistening to {port}{at_baud(port, baud)}{count} ...", end="")

    with open_port(port, min(bauds)) as opened:
        baud = likeliest_baud(opened, bauds, trying)
        console.print()
        if baud is None:
            return None
        rates = f"; baud rates tried: {', '.join(map(str, tried))}" if len(tried) > 1 else ""
        return Found(port, baud, _describe(console, opened, f"{port}{at_baud(port, baud)}", rates, grid))


def _describe(console: Console, opened: Port, where: str, tried: str, grid: Grid | None) -> PadFormat | None:
    """Return the proven description of the sender, or print what its bytes look like and what is missing."""
    while True:
        at_rest: list[Chunk] = []
        if can_ask():
            finding, at_rest = find_with_a_hand(console, opened, grid)
        else:
            finding = find_without_asking(console.print, opened, (grid,))
        if finding.proposed is None:
            console.print(f"{where}: {finding.arrived}; {finding.missing}{tried}", style="yellow")
            return None
        if not can_ask():
            return finding.proposed
        if turned := turned_with_a_hand(console, opened, finding.proposed, at_rest):
            return turned
        console.print("once more: are the rows and columns right?", style="yellow")
        grid = None


def _urls_of_robot(typed: str) -> Sequence[str]:
    """Return where a robot may answer, the likeliest first; empty for no robot. Raises RobotError."""
    return () if typed in ("", "none") else robot_urls(typed)


def _ask_robot(console: Console) -> Sequence[str]:
    """Return where the robot that the user types may answer; empty without a terminal."""
    while can_ask():
        console.print("The robot's name or address, as in nao.local (Enter: no robot): ", end="")
        try:
            return _urls_of_robot(sys.stdin.readline().strip())
        except RobotError as error:
            console.print(str(error), style="yellow")
    return ()
