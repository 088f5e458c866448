"""The classifier as the daemon runs it: ONNX Runtime on one thread; the caller keeps the state."""

import os
import threading
import zlib
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, TypeAlias

import msgspec
import numpy as np
import onnxruntime
from numpy.typing import NDArray

from touchd.drivers.errors import TouchdError, os_errors_as
from touchd.drivers.frame import COLUMNS, FRAME_RATE_HZ, MAX_COUNT, ROWS

SHIPPED_MODEL = Path(__file__).parent / "weights" / "touchd.onnx"
METADATA_KEY = "touchd"
ADVICE = "check `model` in the configuration"
# Limits for a file that may come from anywhere.
MAX_FILE_BYTES = 32 * 1024 * 1024
TRIAL_S = 10.0
TRIAL_FRAMES = 54
# The highest mean rest, and rest of a taxel, that the network knows. Pads in the training data rest at up to
# 8 counts on average, and at up to 28 in a single taxel.
KNOWN_REST_COUNTS, KNOWN_TAXEL_COUNTS = 10.0, 30.0

# Every prediction event carries all labels; these limits bound its size.
MOST_LABELS, LONGEST_LABEL = 12, 24
Label: TypeAlias = Annotated[str, msgspec.Meta(pattern=rf"^[A-Za-z0-9_-]{{1,{LONGEST_LABEL}}}$")]
Labels: TypeAlias = Annotated[tuple[Label, ...], msgspec.Meta(min_length=1, max_length=MOST_LABELS)]
Name: TypeAlias = Annotated[str, msgspec.Meta(pattern=r"^[A-Za-z0-9_.+-]{1,64}$")]


class ModelError(TouchdError):
    """A model file is missing, damaged or not made for this pad; the message says which and what to do."""


class ModelMetadata(msgspec.Struct, frozen=True, kw_only=True):
    """A model file's description of itself: JSON under the key "touchd" of its ONNX metadata."""

    name: Name
    labels: Labels
    frame_rate_hz: float
    framing: str
    lengths: tuple[int, ...]
    max_length: int
    temperatures: dict[str, float]
    training: dict[str, Any]
    code_version: str
    data_sha256: str
    scores: dict[str, Any]


ModelState: TypeAlias = Mapping[str, NDArray[Any]]
"""The network's state after a touch's frames so far: arrays by the name of the model input.

touchd-1, with which the tables compare, has no such inputs; its state is the frames themselves, as "counts".
"""


@dataclass(frozen=True)
class Classifier:
    """Classifies a window: counts (T, 8, 8) to probabilities (labels,), any T up to `metadata.max_length`."""

    metadata: ModelMetadata
    session: onnxruntime.InferenceSession
    states: tuple[str, ...]
    """Names of the state inputs; empty for touchd-1."""

    @classmethod
    def load(cls, path: Path = SHIPPED_MODEL, threads: int = 1) -> "Classifier":
        """Load an exported model file; raises ModelError if it is missing, damaged or not of touchd.

        For a file from elsewhere see `load_own`.
        """
        session = open_session(path, threads)
        stored = session.get_modelmeta().custom_metadata_map.get(METADATA_KEY)
        if stored is None:
            raise ModelError(
                f"{path}: not a touchd model (it carries no metadata); make one with `touchd train --extra`"
            )
        try:
            metadata = msgspec.json.decode(stored, type=ModelMetadata)
        except msgspec.DecodeError as error:
            raise ModelError(f"{path}: its touchd metadata is damaged ({error}); export it again") from error
        states = session.get_overridable_initializers()
        return cls(metadata, session, tuple(entry.name for entry in states))

    @property
    def labels(self) -> tuple[str, ...]:
        """The gestures in the order of the probabilities."""
        return self.metadata.labels

    @property
    def name(self) -> str:
        return self.metadata.name

    def probabilities(self, frames: NDArray[np.generic]) -> NDArray[np.float64]:
        """Return calibrated probabilities (labels,) for counts (T, 8, 8), integers or floats in 0 to 1023.

        Raises ValueError for any other shape, length or value, also for one that is not finite.
        """
        probabilities: NDArray[np.float64] = self.batch_probabilities(frames[np.newaxis])[0]
        return probabilities

    def batch_probabilities(self, windows: NDArray[np.generic]) -> NDArray[np.float64]:
        """Return probabilities (B, labels) for B windows of equal length, counts (B, T, 8, 8)."""
        (probabilities,) = self.session.run(["probabilities"], {"counts": self._checked(windows)})
        return np.asarray(probabilities, dtype=np.float64)

    def step(
        self, frames: NDArray[np.generic], state: ModelState | None = None
    ) -> tuple[NDArray[np.float64], ModelState]:
        """Return probabilities (labels,) over all frames of a touch so far, and the next state.

        frames: the touch's next (T, 8, 8) counts; state: from the previous call, None at first. The result
        equals `probabilities` of all the frames, up to rounding. Raises ValueError.
        """
        counts = self._checked(frames[np.newaxis])
        if not self.states:
            counts = counts if state is None else np.concatenate([state["counts"], counts], axis=1)
            return self.batch_probabilities(counts)[0], {"counts": counts}
        # Pass plain arrays: wrapping them in ONNX Runtime's own type takes a quarter of a step's time.
        names = ["probabilities", *(f"next_{name}" for name in self.states)]
        answers, *after = self.session.run(names, {"counts": counts, **(state or {})})
        return np.asarray(answers[0], dtype=np.float64), dict(zip(self.states, after, strict=True))

    def _checked(self, windows: NDArray[np.generic]) -> NDArray[np.float32]:
        counts, longest = np.ascontiguousarray(windows, dtype=np.float32), self.metadata.max_length
        is_window = counts.shape[2:] == (ROWS, COLUMNS) and 1 <= counts.shape[1] <= longest
        # A NaN fails both comparisons, so this also refuses what is not finite.
        if not is_window or not (counts.min(initial=0.0) >= 0.0 and counts.max(initial=0.0) <= MAX_COUNT):
            wanted = f"1 to {longest} frames of {ROWS}x{COLUMNS} counts from 0 to {MAX_COUNT}"
            raise ValueError(f"the model takes {wanted}; this is {counts.shape[1:]}")
        return counts


def subtract_high_rest(frames: NDArray[np.float32], rest: NDArray[np.float32]) -> NDArray[np.float32]:
    """Subtract a pad's rest (64 counts) from (T, 8, 8) counts where it is higher than the network knows.

    Otherwise the network classifies every touch on a pad that rests at 60 counts as constant.
    """
    if rest.sum() > KNOWN_REST_COUNTS * rest.size:
        higher = rest
    elif rest.max() > KNOWN_TAXEL_COUNTS:
        higher = np.where(rest > KNOWN_TAXEL_COUNTS, rest, 0)
    else:
        return frames
    above: NDArray[np.float32] = np.maximum(frames - higher.reshape(frames.shape[1:]), 0)
    return above


def load_own(path: Path) -> Classifier:
    """Load a user's file, from wherever it comes; raises ModelError if it is not a model for this pad."""
    with os_errors_as(ModelError, f"{path}: the model cannot be read", ADVICE):
        # Reading a pipe or a device may never end.
        if path.is_fifo() or path.is_char_device():
            raise ModelError(f"{path}: is not a file; {ADVICE}")
        if path.stat().st_size > MAX_FILE_BYTES:
            raise ModelError(f"{path}: larger than {MAX_FILE_BYTES >> 20} MiB; not a touchd model")
    classifier = Classifier.load(path)
    metadata = classifier.metadata
    if metadata.frame_rate_hz != FRAME_RATE_HZ:
        raise ModelError(
            f"{path}: made for {metadata.frame_rate_hz} Hz, the pad is read at {FRAME_RATE_HZ} Hz"
        )
    if metadata.framing != "live":
        raise ModelError(f"{path}: made for {metadata.framing} framing; a pad sends live frames")
    _try_out(path, metadata, classifier.session)
    return classifier


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


def open_session(path: Path, threads: int) -> onnxruntime.InferenceSession:
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = threads
    options.inter_op_num_threads = 1
    options.execution_mode = onnxruntime.ExecutionMode.ORT_SEQUENTIAL
    options.log_severity_level = 3
    # Denormal floats are tens of times slower and have no effect here.
    options.add_session_config_entry("session.set_denormal_as_zero", "1")
    # By default, external weights are loaded from the working folder; this path has none.
    options.add_session_config_entry("session.model_external_initializers_file_folder_path", os.devnull)
    # A spinning pool would burn the idle core of a robot's companion computer.
    options.add_session_config_entry("session.intra_op.allow_spinning", "0")
    with os_errors_as(ModelError, f"{path}: the model cannot be read", ADVICE):
        content = path.read_bytes()
        _check_digest(path, content)
    try:
        return onnxruntime.InferenceSession(
            content,
            options,
            providers=["CPUExecutionProvider"],
            # At this width, the fused kernel is six times slower than the operators that it replaces.
            disabled_optimizers=["SkipLayerNormFusion"],
        )
    except Exception as error:  # ONNX Runtime raises its own undocumented types
        why = str(error).splitlines()[0]
        raise ModelError(f"{path}: ONNX Runtime refuses the file ({why}); {ADVICE}") from error


def digest_file(path: Path) -> Path:
    """Return the file beside a model that holds its CRC-32."""
    return path.with_name(f"{path.name}.crc32")


def digest_of(content: bytes) -> str:
    """Return a model's CRC-32 in hexadecimal, which reveals flipped bits; hashlib would take 4 MB."""
    return f"{zlib.crc32(content):08x}"


def _check_digest(path: Path, content: bytes) -> None:
    """Raise ModelError if the content does not match the digest file beside it, as after a bit flip."""
    beside = digest_file(path)
    if beside.exists() and beside.read_text(errors="replace").strip() != digest_of(content):
        raise ModelError(f"{path}: damaged, its CRC-32 is not that in {beside.name}; install touchd again")
