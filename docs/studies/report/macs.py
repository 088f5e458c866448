"""Multiply-adds of one answer, counted in the ONNX graph that gives it.

Counted are the products of convolutions, linear layers and attention, as is usual; norms, activations and
sums over time are not.
"""

import math
from collections.abc import Callable, Mapping
from pathlib import Path

import numpy as np
import onnx
import onnxruntime

from drivers.frame import COLUMNS, ROWS

Shapes = Mapping[str, tuple[int, ...]]


def multiply_adds(model: Path, frames: int, windows: int = 1) -> int:
    """Return how many multiply-adds the file's products take for that many windows of counts.

    The graph is run once, as shapes inside it follow from the length of the window.
    """
    graph = onnx.load(model)
    counted = [node for node in graph.graph.node if node.op_type in PRODUCTS]
    shapes = _shapes(graph, counted, np.zeros((windows, frames, ROWS, COLUMNS), np.float32))
    return sum(PRODUCTS[node.op_type](node, shapes) for node in counted)


def _shapes(graph: onnx.ModelProto, nodes: list[onnx.NodeProto], counts: np.ndarray) -> Shapes:
    """Return the shapes of the nodes' inputs and outputs."""
    shapes = {weight.name: tuple(weight.dims) for weight in graph.graph.initializer}
    named = {name for node in nodes for name in (*node.input, *node.output) if name}
    inside = sorted(named - shapes.keys() - {"counts"})
    del graph.graph.output[:]
    graph.graph.output.extend(onnx.helper.make_empty_tensor_value_info(name) for name in inside)
    session = onnxruntime.InferenceSession(graph.SerializeToString(), providers=["CPUExecutionProvider"])
    found = session.run(inside, {"counts": counts})
    return {**shapes, **{name: value.shape for name, value in zip(inside, found, strict=True)}}


def _convolution(node: onnx.NodeProto, shapes: Shapes) -> int:
    # Weights are (channels out, channels in a group, *kernel).
    return math.prod(shapes[node.output[0]]) * math.prod(shapes[node.input[1]][1:])


def _matrix_product(node: onnx.NodeProto, shapes: Shapes) -> int:
    return math.prod(shapes[node.output[0]]) * shapes[node.input[0]][-1]


def _linear(node: onnx.NodeProto, shapes: Shapes) -> int:
    turned = any(attribute.name == "transA" and attribute.i for attribute in node.attribute)
    return math.prod(shapes[node.output[0]]) * shapes[node.input[0]][0 if turned else 1]


def _recurrence(node: onnx.NodeProto, shapes: Shapes) -> int:
    # Inputs are (steps, windows, width); each meets all weights, as does the state before.
    steps, windows, _ = shapes[node.input[0]]
    return steps * windows * sum(math.prod(shapes[weights]) for weights in node.input[1:3])


PRODUCTS: Mapping[str, Callable[[onnx.NodeProto, Shapes], int]] = {
    "Conv": _convolution,
    "MatMul": _matrix_product,
    "Gemm": _linear,
    "LSTM": _recurrence,
}
