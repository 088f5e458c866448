"""Repeats a recording as a pad, a pty linked at /dev/touchd-pad, until SIGTERM: pad.py RECORDING."""

import os
import pty
import signal
import sys
import time
import tty
from contextlib import suppress
from pathlib import Path

from touchd.daemon.app.config import DEFAULT_PORT, SensorSettings
from touchd.daemon.playback.rig import encoder_for
from touchd.drivers.frame import FRAME_RATE_HZ
from touchd.drivers.recording import read_recordings, splice


def main() -> None:
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    stream, encode = splice(read_recordings(Path(sys.argv[1]))), encoder_for(SensorSettings())
    master, slave = pty.openpty()
    path = os.ttyname(slave)
    os.chmod(path, 0o666)
    tty.setraw(slave)
    os.close(slave)
    os.set_blocking(master, False)
    os.symlink(path, DEFAULT_PORT)
    begun_s, number = time.monotonic(), 0
    try:
        while True:
            clock_s = number / FRAME_RATE_HZ
            packet = encode(stream.counts[number % len(stream.counts)], round(1000 * clock_s))
            time.sleep(max(0.0, begun_s + clock_s - time.monotonic()))
            # Frames that nobody reads are lost, as with a real pad.
            with suppress(OSError):
                os.write(master, packet)
            number += 1
    except KeyboardInterrupt:
        os.unlink(DEFAULT_PORT)


if __name__ == "__main__":
    main()
