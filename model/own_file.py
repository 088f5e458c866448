"""A model file of the user's own: whether it fits the pad, and gives probabilities in time."""

import threading
from pathlib import Path

import numpy as np
import onnxruntime

from touchd.drivers.errors import os_errors_as
from touchd.drivers.frame import COLUMNS, FRAME_RATE_HZ, ROWS
from touchd.model.classifier import ADVICE, Classifier, ModelError, ModelMetadata

MAX_FILE_BYTES = 32 * 1024 * 1024
TRIAL_S = 10.0
TRIAL_FRAMES = 54


def load_own(path: Path) -> Classifier:
    """Load a file that may come from anywhere; raises ModelError if it is not a model for this pad."""
    with os_errors_as(ModelError, f"{path}: the model cannot be read", ADVICE):
        # Reading a pipe or a device may never end.
        if path.is_fifo() or path.is_char_device():
            raise ModelError(f"{path}: is not a file; {ADVICE}")
        if path.stat().st_size > MAX_FILE_BYTES:
            raise ModelError(f"{path}: larger than {MAX_FILE_BYTES >> 20} MiB; not a touchd model")
    classifier = Classifier.load(path)
    _check_fit(path, classifier.metadata, classifier.session)
    _try_out(path, classifier.metadata, classifier.session)
    return classifier


def _check_fit(path: Path, metadata: ModelMetadata, session: onnxruntime.InferenceSession) -> None:
    if metadata.frame_rate_hz != FRAME_RATE_HZ:
        raise ModelError(
            f"{path}: made for {metadata.frame_rate_hz} Hz, the pad is read at {FRAME_RATE_HZ} Hz"
        )
    if metadata.framing != "live":
        raise ModelError(f"{path}: made for {metadata.framing} framing; a pad sends live frames")
    # None: the model must accept any batch size and any number of frames.
    inputs = [
        (entry.name, entry.type, [size if isinstance(size, int) else None for size in entry.shape])
        for entry in session.get_inputs()
    ]
    if inputs != [("counts", "tensor(float)", [None, None, ROWS, COLUMNS])]:
        raise ModelError(
            f"{path}: its inputs are {inputs}, not any number of {ROWS}x{COLUMNS} taxels' counts"
        )
    outputs = [entry.name for entry in session.get_outputs()]
    if unknown := [name for name in outputs if name != "probabilities" and not name.startswith("next_")]:
        raise ModelError(f"{path}: has another output than probabilities: {unknown[0]}; export it again")


def _try_out(path: Path, metadata: ModelMetadata, session: onnxruntime.InferenceSession) -> None:
    """Classify a pad at rest; raises ModelError unless this gives probabilities within TRIAL_S."""
    options = onnxruntime.RunOptions()
    # A loop in the graph may have no end.
    limit = threading.Timer(TRIAL_S, setattr, (options, "terminate", True))
    limit.daemon = True
    limit.start()
    try:
        rest = np.zeros((1, min(TRIAL_FRAMES, metadata.max_length), ROWS, COLUMNS), np.float32)
        (answer,) = session.run(["probabilities"], {"counts": rest}, options)
    except Exception as error:  # ONNX Runtime raises its own undocumented types
        why = str(error).splitlines()[0] if limit.is_alive() else f"no answer within {TRIAL_S:g} s"
        raise ModelError(f"{path}: gives no answer for a pad at rest ({why}); export it again") from error
    finally:
        limit.cancel()
        limit.join()
    answer = np.asarray(answer)
    if answer.shape != (1, len(metadata.labels)):
        is_row = answer.ndim == 2 and len(answer) == 1
        found = answer.shape[1] if is_row else f"answers of shape {answer.shape}, not"
        raise ModelError(f"{path}: {found} outputs for {len(metadata.labels)} labels; export it again")
    if not (answer.min() >= -1e-6 and abs(float(answer.sum()) - 1.0) <= 1e-3):
        raise ModelError(f"{path}: its answers are not probabilities; export it again")
