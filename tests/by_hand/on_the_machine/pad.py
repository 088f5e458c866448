"""The lab's pad, as an Arduino Mega that this machine's kernel finds on its USB (dummy_hcd, cdc_acm).

    /opt/touchd/bin/python pad.py RECORDING [SLOWER]

Without these kernel modules it is a pty, linked as /dev/touchd-pad. The recording repeats, SLOWER times
slower than its clock says. Plugged in at the start, unplugged at SIGTERM.
"""

import os
import pty
import signal
import subprocess
import sys
import time
import tty
from contextlib import suppress
from pathlib import Path

from touchd.daemon.config import DEFAULT_PORT, SensorSettings
from touchd.daemon.playback.rig import encoder_for
from touchd.drivers.frame import FRAME_RATE_HZ
from touchd.drivers.recording import read_recordings, splice

GADGET = Path("/sys/kernel/config/usb_gadget/pad")
# How the udev rule identifies an Arduino Mega 2560.
VENDOR, PRODUCT = "0x2341", "0x0042"


def plug_in_board() -> int:
    """Plug a new board into the kernel's USB; returns where to write its output."""
    function = GADGET / "functions/acm.usb0"
    if not GADGET.exists():
        function.mkdir(parents=True)
        (GADGET / "configs/c.1").mkdir()
        (GADGET / "idVendor").write_text(VENDOR)
        (GADGET / "idProduct").write_text(PRODUCT)
        (GADGET / "configs/c.1/acm.usb0").symlink_to(function)
    (GADGET / "UDC").write_text("dummy_udc.0")
    return os.open("/dev/ttyGS0", os.O_WRONLY | os.O_NONBLOCK | os.O_NOCTTY)


def plug_in_pty() -> int:
    """Link a pty as the pad; returns where to write its output."""
    master, slave = pty.openpty()
    path = os.ttyname(slave)
    os.chmod(path, 0o666)
    tty.setraw(slave)
    os.close(slave)
    os.symlink(path, DEFAULT_PORT)
    os.set_blocking(master, False)
    return master


def play(fd: int, recording: Path, slower: float) -> None:
    """Repeat the recording; frames that nobody reads are lost, as with a real pad."""
    stream = splice(read_recordings(recording))
    encode = encoder_for(SensorSettings())
    begun_s, number = time.monotonic(), 0
    while True:
        clock_s = number / FRAME_RATE_HZ
        packet = encode(stream.counts[number % len(stream.counts)], round(1000 * clock_s))
        time.sleep(max(0.0, begun_s + clock_s * slower - time.monotonic()))
        with suppress(BlockingIOError, OSError):
            os.write(fd, packet)
        number += 1


def main() -> None:
    """Act as the pad until SIGTERM."""
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    modules = ("configfs", "libcomposite", "dummy_hcd", "usb_f_acm")
    on_usb = all(
        subprocess.run(["modprobe", "-q", module], check=False).returncode == 0 for module in modules
    )
    fd = plug_in_board() if on_usb else plug_in_pty()
    try:
        play(fd, Path(sys.argv[1]), float(sys.argv[2]) if len(sys.argv) > 2 else 1.0)
    except KeyboardInterrupt:
        pass
    finally:
        if on_usb:
            (GADGET / "UDC").write_text("\n")
        else:
            os.unlink(DEFAULT_PORT)


if __name__ == "__main__":
    main()
