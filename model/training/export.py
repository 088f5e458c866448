"""Export: a trained network and its temperatures into one ONNX file that takes raw counts."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import msgspec
import onnx
import torch
from torch import Tensor, nn

from drivers.frame import COLUMNS, ROWS
from model.classifier import METADATA_KEY, ModelMetadata
from model.tgc import TGC

OPSET = 18


class CalibratedTGC(nn.Module):
    """The network with its softmax and temperature: (B, T, 8, 8) counts to (B, classes) probabilities.

    The temperature at T frames is interpolated linearly between the calibrated lengths (Guo et al. 2017 for
    temperature scaling), constant outside them, so that one file answers at every length.
    """

    first: Tensor
    lengths: Tensor
    bends: Tensor

    def __init__(self, network: TGC, temperatures: Mapping[int, float]) -> None:
        super().__init__()
        self.network = network
        lengths = torch.tensor(sorted(temperatures), dtype=torch.float32)
        values = torch.tensor([temperatures[int(length)] for length in lengths], dtype=torch.float32)
        slopes = torch.diff(values) / torch.diff(lengths)
        self.register_buffer("first", values[0])
        self.register_buffer("lengths", lengths)
        # The slope that begins at each calibrated length, less the one that ends there.
        self.register_buffer("bends", torch.diff(slopes, prepend=torch.zeros(1), append=torch.zeros(1)))

    def forward(self, counts: Tensor) -> Tensor:
        """Return (B, classes) probabilities."""
        frames = torch.ones_like(counts[0, :, 0, 0]).sum()
        temperature = self.first + (self.bends * torch.relu(frames - self.lengths)).sum()
        return torch.softmax(self.network(counts) / temperature, dim=-1)


def export(network: TGC, metadata: ModelMetadata, path: Path) -> None:
    """Write the network as one ONNX file that describes itself."""
    temperatures = {int(length): value for length, value in metadata.temperatures.items()}
    calibrated = CalibratedTGC(network, temperatures).eval()
    example = torch.zeros(2, 144, ROWS, COLUMNS)
    program = torch.onnx.export(
        calibrated,
        (example,),
        dynamo=True,
        verbose=False,
        opset_version=OPSET,
        input_names=["counts"],
        output_names=["probabilities"],
        dynamic_shapes={"counts": {0: torch.export.Dim("batch"), 1: torch.export.Dim("frames", min=1)}},
    )
    assert program is not None
    proto = program.model_proto
    _forget_where_it_was_made(proto)
    entry = proto.metadata_props.add()
    entry.key, entry.value = METADATA_KEY, msgspec.json.encode(metadata).decode()
    onnx.checker.check_model(proto)
    path.parent.mkdir(parents=True, exist_ok=True)
    onnx.save(proto, path)


def _forget_where_it_was_made(proto: onnx.ModelProto) -> None:
    """Remove what the exporter notes of source files and their places on this machine."""
    for entry in (*proto.graph.node, *proto.graph.value_info, *proto.graph.input, *proto.graph.output):
        del entry.metadata_props[:]
        entry.doc_string = ""
    for tensor in proto.graph.initializer:
        del tensor.metadata_props[:]
    del proto.graph.metadata_props[:]
