"""References for a model file: its network in PyTorch and float64, and a copy with larger logits."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import onnx
import torch
from numpy.typing import NDArray
from onnx import numpy_helper

from touchd.model.classifier import ModelMetadata
from touchd.model.training import checkpoint
from touchd.model.training.export import CalibratedTGC
from touchd.model.training.stepwise import TGCState, initial_state


@dataclass(frozen=True)
class Reference:
    """A trained network in PyTorch and float64; takes counts (T, 8, 8)."""

    calibrated: CalibratedTGC

    @classmethod
    def load(cls, path: Path, metadata: ModelMetadata) -> "Reference":
        """Load the network from a checkpoint, and its temperatures from the exported file's metadata.

        Raises CheckpointError.
        """
        temperatures = {int(length): value for length, value in metadata.temperatures.items()}
        return cls(CalibratedTGC(checkpoint.load(path).build(), temperatures).double().eval())

    @torch.no_grad()
    def probabilities(self, counts: NDArray[np.generic]) -> NDArray[np.float64]:
        """Return calibrated probabilities (7,)."""
        return _array(self.calibrated(batch(counts))[0])

    @torch.no_grad()
    def logits(self, counts: NDArray[np.generic]) -> NDArray[np.float64]:
        """Return the logits (7,) of the whole window."""
        return _array(self.calibrated.network(batch(counts))[0])

    @torch.no_grad()
    def logits_at(self, counts: NDArray[np.generic], length: int) -> NDArray[np.float64]:
        """Return the logits (7,) of the first `length` frames, from one pass over all frames."""
        return _array(self.calibrated.network.at_lengths(batch(counts), torch.tensor([[length]]))[0, 0])

    def initial_state(self) -> TGCState:
        """Return the state before the first frame."""
        return initial_state(self.calibrated.network)

    @torch.no_grad()
    def step(self, counts: NDArray[np.generic], state: TGCState) -> tuple[NDArray[np.float64], TGCState]:
        """Return calibrated probabilities (7,) over all frames so far, and the next state."""
        answer, after = self.calibrated.step(batch(counts), state)
        return _array(answer[0]), after


def batch(counts: NDArray[np.generic]) -> torch.Tensor:
    """Return counts (T, 8, 8) as a float64 batch of one."""
    return torch.from_numpy(counts[np.newaxis].astype(np.float64))


def _array(tensor: torch.Tensor) -> NDArray[np.float64]:
    array: NDArray[np.float64] = tensor.numpy()
    return array


def scale_logits(path: Path, factor: float, copy: Path) -> None:
    """Write a copy of the model file whose logits are multiplied by `factor` before the softmax.

    This makes them far larger than those of any trained network.
    """
    proto = onnx.load(path)
    output = proto.graph.output[0]  # the probabilities; the other outputs are the state
    place, softmax = next((i, node) for i, node in enumerate(proto.graph.node) if output.name in node.output)
    names = [f"{output.name}_{part}_{place}" for part in ("factor", "scaled_logits")]
    proto.graph.initializer.append(numpy_helper.from_array(np.float32(factor), names[0]))
    multiply = onnx.helper.make_node("Mul", [softmax.input[0], names[0]], [names[1]])
    softmax.input[0] = names[1]
    proto.graph.node.insert(place, multiply)
    onnx.save(proto, copy)
