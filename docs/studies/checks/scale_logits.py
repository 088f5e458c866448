"""A copy of a model file whose logits are far larger than any that a network was trained to give."""

from pathlib import Path

import numpy as np
import onnx
from onnx import numpy_helper


def scale_logits(path: Path, factor: float, copy: Path) -> None:
    """Write a copy of the model file at `path` whose logits are multiplied before the softmax."""
    proto = onnx.load(path)
    output = proto.graph.output[0]  # the probabilities; what is left is the state
    place, softmax = next((i, node) for i, node in enumerate(proto.graph.node) if output.name in node.output)
    names = [f"{output.name}_{part}_{place}" for part in ("factor", "scaled_logits")]
    proto.graph.initializer.append(numpy_helper.from_array(np.float32(factor), names[0]))
    multiply = onnx.helper.make_node("Mul", [softmax.input[0], names[0]], [names[1]])
    softmax.input[0] = names[1]
    proto.graph.node.insert(place, multiply)
    onnx.save(proto, copy)
