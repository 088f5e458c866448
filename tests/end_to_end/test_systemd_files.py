"""The unit lets in every kind of serial port, and the udev rules keep ModemManager off the usual boards."""

import re
from fnmatch import fnmatchcase
from pathlib import Path

import pytest

SYSTEMD = Path(__file__).parents[2] / "systemd"
ALLOWED = [
    line.split("=")[1].split()[0].removeprefix("char-")
    for line in (SYSTEMD / "touchd.service").read_text().splitlines()
    if line.startswith("DeviceAllow=")
]


@pytest.mark.parametrize(
    ("driver", "is_allowed"),
    [
        *((name, True) for name in ("ttyACM", "ttyUSB", "ttyAMA", "ttyS", "ttyTHS", "ttymxc", "rfcomm")),
        *((name, True) for name in ("ttyCH343USB", "ttyCH341USB", "ttyXRUSB", "ttyAML", "ttySC", "ttyGS")),
        *((name, False) for name in ("tty", "ttyprintk", "mem", "input", "sg", "hidraw", "ptm", "video")),
    ],
)
def test_the_service_may_open_serial_ports_alone(driver: str, is_allowed: bool) -> None:
    # As systemd matches the names in /proc/devices.
    assert any(fnmatchcase(driver, pattern) for pattern in ALLOWED) is is_allowed


def told_of(vendor: str, product: str) -> dict[str, str]:
    """Return what the rules assign to a tty of this USB board."""
    board, assigned = {"idVendor": vendor, "idProduct": product}, dict[str, str]()
    for line in (SYSTEMD / "99-touchd.rules").read_text().splitlines():
        wanted = re.findall(r'ATTRS\{(\w+)\}=="([^"]*)"', line)
        if line.startswith("ATTRS") and all(
            any(fnmatchcase(board[name], each) for each in pattern.split("|")) for name, pattern in wanted
        ):
            assigned |= dict(re.findall(r'(\w+(?:\{\w+\})?)\+?="([^"]*)"', line))
    return assigned


@pytest.mark.parametrize(
    ("vendor", "product", "has_name"),
    [
        ("2341", "0042", True),
        ("2a03", "0042", True),
        ("16c0", "0483", True),
        ("2341", "0043", False),
        ("2341", "8036", False),
        ("2e8a", "000a", False),
        ("303a", "1001", False),
        ("10c4", "ea60", False),
        ("0403", "6001", False),
        ("1a86", "7523", False),
        ("1a86", "55d4", False),
    ],
    ids=[
        "Mega",
        "Mega.org",
        "Teensy",
        "Uno",
        "Leonardo",
        "RP2040",
        "ESP32-S3",
        "CP210x",
        "FTDI",
        "CH340",
        "CH9102",
    ],
)
def test_modem_commands_are_kept_from_the_usual_boards(vendor: str, product: str, has_name: bool) -> None:
    told = told_of(vendor, product)
    assert told["ENV{ID_MM_DEVICE_IGNORE}"] == "1"
    assert (told.get("SYMLINK") == "touchd-pad") is has_name


def test_a_modem_is_left_to_its_manager() -> None:
    assert told_of("12d1", "1506") == {}
