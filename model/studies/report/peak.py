"""Peak memory of a process that only opens one network and answers with it.

Run as a program, it is that process.
"""

import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import onnxruntime

from touchd.drivers.frame import COLUMNS, ROWS

ANSWERS = 10
LIMIT_S = 300.0


def peak_bytes(model: Path, frames: int, windows: int = 1) -> int:
    """Return the peak resident memory, in bytes, while the file answers that many windows at once.

    Of this, a process without any network takes `idle_bytes`.
    """
    return _child(str(model), str(frames), str(windows))


def idle_bytes() -> int:
    """Return the memory of Python with NumPy and ONNX Runtime before a network is opened, in bytes."""
    return _child()


def open_session(model: Path) -> onnxruntime.InferenceSession:
    """Open any network's file on one thread, as ONNX Runtime opens files by default."""
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = 1
    options.inter_op_num_threads = 1
    options.log_severity_level = 3
    return onnxruntime.InferenceSession(model, options, providers=["CPUExecutionProvider"])


def main(arguments: Sequence[str]) -> int:
    """Answer as often as is needed for memory to settle, and write how much it was; returns 0."""
    if arguments:
        model, frames, windows = arguments
        session = open_session(Path(model))
        counts = np.zeros((int(windows), int(frames), ROWS, COLUMNS), np.float32)
        for _ in range(ANSWERS):
            session.run(None, {"counts": counts})
    sys.stdout.write(f"{_high_water_bytes()}\n")
    return 0


def _child(*arguments: str) -> int:
    command = [sys.executable, "-m", "touchd.model.studies.report.peak", *arguments]
    done = subprocess.run(command, capture_output=True, text=True, check=True, timeout=LIMIT_S)
    return int(done.stdout)


def _high_water_bytes() -> int:
    # Not getrusage, whose maximum is inherited from the process that started this one.
    for line in Path("/proc/self/status").read_text().splitlines():
        if line.startswith("VmHWM:"):
            return int(line.split()[1]) * 1024
    raise RuntimeError("the kernel does not tell how much memory a process took")


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
