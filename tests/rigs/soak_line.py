"""The soak's pad, in a separate process, so that its memory is not counted.

Writes a repeating stream with some garbage to standard output. At times the board restarts, and its clock
begins again.
"""

import os
import random
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np

from touchd.daemon.app.config import SensorSettings
from touchd.daemon.playback.rig import encoder_for
from touchd.daemon.playback.stream import with_quiet
from touchd.drivers.frame import FRAME_RATE_HZ
from touchd.drivers.recording import Stream, read_recordings, realign, splice
from touchd.model.studies.simulated import simulate

CHUNK_FRAMES = 20
GARBAGE_EVERY_CHUNKS = 50
RESTART_EVERY_CHUNKS = 1000
PIECE_BYTES = 4096
PERIOD_MS = round(1000 / FRAME_RATE_HZ)
GESTURES = ("pat", "stroke", "rub", "scratch", "tickle", "constant")


def recorded() -> Stream:
    """Return HAART's test participants if the folder is set, else ten minutes of a simulated hand.

    Touches in passing, of a tenth of a second to half a second, follow.
    """
    touching, passing = _touching(), random.Random(3)
    script = [("notouch", 3.0)]
    for _ in range(40):
        script += [
            (passing.choice(GESTURES), passing.uniform(0.1, 0.5)),
            ("notouch", passing.uniform(1.2, 3.0)),
        ]
    brief = splice(simulate(script, 4))
    clock_ms = brief.sensor_ms - brief.sensor_ms[0] + touching.sensor_ms[-1] + PERIOD_MS
    counts = np.concatenate([touching.counts, brief.counts])
    return Stream(counts, np.concatenate([touching.sensor_ms, clock_ms]), ())


def _touching() -> Stream:
    if folder := os.environ.get("TOUCHD_HAART"):
        path = Path(folder) / "testWITHLABELS.csv.gz"
        found = [realign(recording) for recording in read_recordings(path, {"cover": ["none"]})]
        touching = [recording for recording in found if recording.gesture != "notouch"]
        return with_quiet(touching, [recording for recording in found if recording.gesture == "notouch"])
    rng = random.Random(1)
    script = [("notouch", 3.0)]
    for _ in range(120):
        script += [(rng.choice(GESTURES), rng.uniform(0.3, 6.0)), ("notouch", rng.uniform(1.2, 3.0))]
    return splice(simulate(script, 1))


def line(stream: Stream, settings: SensorSettings) -> Iterator[bytes]:
    """Yield what the pad sends, without end."""
    encode_frame = encoder_for(settings)
    rng = random.Random(2)
    offset_ms, chunks = 0, 0
    round_ms = int(stream.sensor_ms[-1] - stream.sensor_ms[0]) + PERIOD_MS
    while True:
        for start in range(0, len(stream.counts), CHUNK_FRAMES):
            part = slice(start, start + CHUNK_FRAMES)
            chunks += 1
            garbage = rng.randbytes(rng.randrange(400)) if chunks % GARBAGE_EVERY_CHUNKS == 0 else b""
            if chunks % RESTART_EVERY_CHUNKS == 0:
                offset_ms = -int(stream.sensor_ms[start])
            clock_ms = ((stream.sensor_ms[part] + offset_ms) % 2**32).tolist()
            yield b"".join(map(encode_frame, stream.counts[part], clock_ms)) + garbage
        offset_ms = (offset_ms + round_ms) % 2**32


@contextmanager
def pad() -> Iterator[Iterator[bytes]]:
    """Run the pad; yields its bytes in pieces, as a serial port does."""
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)}
    with subprocess.Popen([sys.executable, __file__], stdout=subprocess.PIPE, env=environment) as process:
        assert process.stdout is not None
        fd = process.stdout.fileno()
        try:
            yield iter(lambda: os.read(fd, PIECE_BYTES), b"")
        finally:
            process.kill()


def main() -> None:
    """Write what the pad sends to standard output."""
    for data in line(recorded(), SensorSettings()):
        sys.stdout.buffer.write(data)


if __name__ == "__main__":
    main()
