"""The name of a serial port that stays the same: by the board's serial number, or by the USB socket.

Also, which USB adapters have no port.
"""

import os
import re
from pathlib import Path
from typing import NamedTuple

BY_ID, BY_PATH = Path("/dev/serial/by-id"), Path("/dev/serial/by-path")
TTY, USB = Path("/sys/class/tty"), Path("/sys/bus/usb/devices")
# Adapters from USB to serial, as in the udev rule: CH340, CP210x, FTDI, PL2303.
ADAPTERS = re.compile(r"1a86:(5523|752[23]|55d.)|10c4:ea(60|70|71)|0403:60(01|1[0145])|067b:2...")
# Arduino and Teensy: the udev rule gives their boards the name /dev/touchd-pad.
VENDORS_OF_THE_RULE = {"2341", "2a03", "16c0"}


class LastingName(NamedTuple):
    """A port's name for a configuration, and why it is that one, in a few words."""

    port: str
    why: str


class Board(NamedTuple):
    """A USB board: its place in /sys, vendor, product, and serial number, "" if it has none."""

    place: Path
    vendor: str
    product: str
    serial: str


def lasting_name(port: str, by_id: Path = BY_ID, by_path: Path = BY_PATH, tty: Path = TTY) -> LastingName:
    """Return the best name for a port.

    /dev/ttyACM0 is whichever board was plugged in first, and two boards may both claim /dev/touchd-pad.
    A name that the user chose, other than these, is returned as it is.
    """
    device = os.path.realpath(port)
    is_link = "://" not in port and os.path.islink(port) and Path(port).name != "touchd-pad"
    if "://" in port or is_link or not os.path.exists(port):
        return LastingName(port, "as given")
    boards = {entry.name: board for entry in tty.glob("*") if (board := _board_of(entry)) is not None}
    own = boards.get(Path(device).name)
    others = {board for board in boards.values() if own and board.place != own.place}
    alike = [board for board in others if own and (board.vendor, board.product) == (own.vendor, own.product)]
    rivals = [board for board in others if board in alike or board.vendor in VENDORS_OF_THE_RULE]
    if os.path.islink(port) and not rivals:
        return LastingName(port, "the name that the udev rule gives this board")
    has_number = own is not None and own.serial and own.serial not in {board.serial for board in alike}
    if has_number and (name := _link_to(device, by_id)):
        return LastingName(name, "it stays with this board, by its serial number")
    if name := _link_to(device, by_path):
        why = (
            "another board has the same serial number"
            if own and own.serial
            else "the board has no serial number"
        )
        return LastingName(name, f"it stays with this socket; {why}")
    return LastingName(port, "the only name that it has")


def why_no_port(usb: Path = USB) -> str:
    """Say which USB adapter is plugged in but has no port, and what to do; "" if there is none.

    brltty, which Ubuntu 22.04 and others install, takes some of them for a Braille display.
    """
    for device in sorted(usb.glob("*")):
        kind = f"{_text(device / 'idVendor')}:{_text(device / 'idProduct')}"
        if ADAPTERS.fullmatch(kind) and not any(device.glob("*:*/tty*")):
            return (
                f"the USB adapter {kind} is plugged in, but has no port; if `sudo dmesg` says that brltty "
                "took it: sudo apt remove brltty, and plug it in again"
            )
    return ""


def _link_to(device: str, folder: Path) -> str | None:
    """Return the first link in a folder that leads to a device."""
    links = sorted(folder.glob("*")) if folder.is_dir() else []
    return next((str(link) for link in links if os.path.realpath(link) == device), None)


def _board_of(entry: Path) -> Board | None:
    """Return the USB board of an entry in /sys/class/tty, None for another kind of port."""
    place = Path(os.path.realpath(entry / "device"))
    for folder in (place, *place.parents):
        if (folder / "idVendor").exists():
            return Board(folder, *(_text(folder / name) for name in ("idVendor", "idProduct", "serial")))
    return None


def _text(path: Path) -> str:
    try:
        return path.read_text(errors="replace").strip()
    except OSError:
        return ""
