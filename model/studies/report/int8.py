"""int8 copies of a model file, by ONNX Runtime's quantization.

Dynamic: the linear layers alone, with scales computed for each answer (dynamic convolutions are far slower
than float32 ones). Static: linear layers and convolutions, scales from windows of recordings.
"""

from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
import onnx
from onnxruntime.quantization import (
    CalibrationDataReader,
    QuantFormat,
    QuantType,
    quantize_dynamic,
    quantize_static,
)

from touchd.drivers.recording import Recording
from touchd.model.settings import LENGTHS
from touchd.model.training import haart

CALIBRATION_WINDOWS = 128
WEIGHTS = {"weight_type": QuantType.QInt8, "per_channel": True}


def dynamic(model: Path, folder: Path) -> Path:
    """Return an int8 copy, in the folder, whose scales are computed for each answer."""
    target, linear = folder / f"{model.stem} dynamic.onnx", ["MatMul", "Gemm"]
    quantize_dynamic(_plain(model, folder), target, **WEIGHTS, op_types_to_quantize=linear)
    return target


def static(model: Path, calibration: Sequence[Recording], folder: Path) -> Path:
    """Return an int8 copy, in the folder, whose scales come from windows of the recordings."""
    target, products = folder / f"{model.stem} static.onnx", ["Conv", "MatMul", "Gemm"]
    activations = {"quant_format": QuantFormat.QDQ, "activation_type": QuantType.QUInt8}
    reader = _Windows(calibration)
    quantize_static(
        _plain(model, folder), target, reader, **WEIGHTS, **activations, op_types_to_quantize=products
    )
    return target


def _plain(model: Path, folder: Path) -> Path:
    # The exporter's notes on shapes no longer hold once the quantizer turns a Gemm's weight around.
    proto = onnx.load(model)
    del proto.graph.value_info[:]
    onnx.save(proto, folder / "plain.onnx")
    return folder / "plain.onnx"


class _Windows(CalibrationDataReader):  # type: ignore[misc]
    """Random windows of the longest answered length, one at a time, as ONNX Runtime asks for them."""

    def __init__(self, recordings: Sequence[Recording]) -> None:
        counts = haart.cut(recordings, LENGTHS[-1]).counts
        chosen = np.random.default_rng(0).permutation(len(counts))[:CALIBRATION_WINDOWS]
        self.windows: Iterator[np.ndarray] = iter(counts[chosen].astype(np.float32))

    def get_next(self) -> dict[str, np.ndarray] | None:
        window = next(self.windows, None)
        return None if window is None else {"counts": window[np.newaxis]}
