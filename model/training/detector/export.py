"""Writes a trained detector as one ONNX file that takes a frame and its state, and describes itself."""

from pathlib import Path
from typing import Any

import msgspec
import onnx
import torch
from torch import Tensor, nn

from touchd.drivers.frame import COLUMNS, ROWS
from touchd.model.detector import METADATA_KEY, STATES
from touchd.model.training.detector.network import DetectorNetwork
from touchd.model.training.detector.signals import Pad, begin
from touchd.model.training.export import OPSET, forget_where_it_was_made

TAXELS = ROWS * COLUMNS


class _Step(nn.Module):
    """The graph to export, with its state as a flat list of tensors."""

    def __init__(self, network: DetectorNetwork) -> None:
        super().__init__()
        self.network = network

    def forward(
        self, counts: Tensor, is_touch: Tensor, levels: Tensor, noise: Tensor, peak: Tensor, hidden: Tensor
    ) -> tuple[Tensor, ...]:
        probability, pad, hidden = self.network.step(counts, Pad(levels, noise, peak), hidden, is_touch)
        return probability, *pad, hidden


def export(network: DetectorNetwork, metadata: dict[str, Any], path: Path) -> None:
    """Write the file; metadata: settings and scores, as JSON."""
    width = network.memory.hidden_size
    example = (
        torch.zeros(1, 1, TAXELS),
        torch.zeros(1, 1),
        *begin(torch.zeros(1, 2, TAXELS)),
        torch.zeros(1, width),
    )
    program = torch.onnx.export(
        _Step(network).eval(),
        example,
        dynamo=True,
        verbose=False,
        opset_version=OPSET,
        input_names=["counts", "is_touch", *STATES],
        output_names=["probability", *(f"next_{name}" for name in STATES)],
    )
    assert program is not None
    proto = program.model_proto
    forget_where_it_was_made(proto)
    described = proto.metadata_props.add()
    described.key, described.value = METADATA_KEY, msgspec.json.encode(metadata).decode()
    onnx.checker.check_model(proto)
    path.parent.mkdir(parents=True, exist_ok=True)
    onnx.save(proto, path)
