"""Multiply-adds of one answer, counted in the ONNX graph that gives it.

Counted are the products of convolutions, linear layers and attention, as is usual; norms, activations and
sums over time are not.
"""

import math
from collections.abc import Mapping
from pathlib import Path

import numpy as np
import onnx
import onnxruntime

from touchd.drivers.frame import COLUMNS, ROWS

Shapes = Mapping[str, tuple[int, ...]]
PRODUCTS = ("Conv", "MatMul", "Gemm", "LSTM")


def multiply_adds(model: Path, frames: int, windows: int = 1) -> int:
    """Return how many multiply-adds the file's products take for that many windows of counts.

    The graph is run once, as shapes inside it follow from the length of the window.
    """
    graph = onnx.load(model)
    counted = [node for node in graph.graph.node if node.op_type in PRODUCTS]
    shapes = _shapes(graph, counted, np.zeros((windows, frames, ROWS, COLUMNS), np.float32))
    return sum(_products(node, shapes) for node in counted)


def _shapes(graph: onnx.ModelProto, nodes: list[onnx.NodeProto], counts: np.ndarray) -> Shapes:
    """Return the shapes of the nodes' inputs and outputs."""
    shapes = {"counts": counts.shape} | {each.name: tuple(each.dims) for each in graph.graph.initializer}
    named = {name for node in nodes for name in (*node.input, *node.output) if name}
    inside = sorted(named - shapes.keys())
    del graph.graph.output[:]
    graph.graph.output.extend(onnx.helper.make_empty_tensor_value_info(name) for name in inside)
    session = onnxruntime.InferenceSession(graph.SerializeToString(), providers=["CPUExecutionProvider"])
    found = session.run(inside, {"counts": counts})
    return {**shapes, **{name: value.shape for name, value in zip(inside, found, strict=True)}}


def _products(node: onnx.NodeProto, shapes: Shapes) -> int:
    first, weights, *others = [shapes[name] for name in node.input if name]
    out = math.prod(shapes[node.output[0]])
    match node.op_type:
        case "Conv":  # weights are (channels out, channels in a group, *kernel)
            return out * math.prod(weights[1:])
        case "MatMul":
            return out * first[-1]
        case "Gemm":
            turned = any(attribute.name == "transA" and attribute.i for attribute in node.attribute)
            return out * first[0 if turned else 1]
    # An LSTM's inputs are (steps, windows, width); each meets all weights, as does the state before.
    return math.prod(first[:2]) * (math.prod(weights) + math.prod(others[0]))
