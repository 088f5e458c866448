"""Export: a trained network and its temperatures into one ONNX file that takes raw counts."""

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

import msgspec
import numpy as np
import onnx
import torch
from torch import Tensor, nn

from touchd.drivers.frame import COLUMNS, ROWS
from touchd.model.classifier import METADATA_KEY, ModelMetadata
from touchd.model.tgc import TGC
from touchd.model.training.stepwise import TGCState, initial_state, step

OPSET = 20


class CalibratedTGC(nn.Module):
    """The network with its softmax and temperature: (B, T, 8, 8) counts to (B, classes) probabilities.

    The temperature at T frames is interpolated linearly between the calibrated lengths (Guo et al. 2017 for
    temperature scaling), constant outside them, so that one file answers at every length.
    """

    temperatures: Tensor

    def __init__(self, network: TGC, temperatures: Mapping[int, float]) -> None:
        super().__init__()
        self.network = network
        lengths = sorted(temperatures)
        values = [temperatures[length] for length in lengths]
        by_frames = np.interp(np.arange(1, lengths[-1] + 1), lengths, values).astype(np.float32)
        self.register_buffer("temperatures", torch.from_numpy(by_frames))

    def forward(self, counts: Tensor) -> Tensor:
        """Return (B, classes) probabilities."""
        place = min(counts.shape[1], len(self.temperatures)) - 1
        return torch.softmax(self.network(counts) / self.temperatures[place], dim=-1)

    def step(self, counts: Tensor, state: TGCState) -> tuple[Tensor, TGCState]:
        """Return (B, classes) probabilities over all frames so far, and the next state."""
        logits, state = step(self.network, counts, state)
        place = torch.clamp(state.frames - 1, max=len(self.temperatures) - 1)
        return torch.softmax(logits / self.temperatures[place], dim=-1), state


class _Step(nn.Module):
    """The graph to export, with its state as a flat list of input and output tensors."""

    def __init__(self, calibrated: CalibratedTGC) -> None:
        super().__init__()
        self.calibrated = calibrated

    def forward(
        self,
        counts: Tensor,
        level: Tensor,
        motion: Tensor,
        memory: tuple[Tensor, ...],
        sums: Tensor,
        highest: Tensor,
        frames: Tensor,
    ) -> tuple[Tensor, ...]:
        state = TGCState(level, motion, memory, sums, highest, frames)
        probabilities, after = self.calibrated.step(counts, state)
        return probabilities, *_flat(after)


def export(network: TGC, metadata: ModelMetadata, path: Path) -> None:
    """Write the network as one ONNX file that describes itself.

    Given `counts` alone, it classifies a whole window. Given also the state that an earlier call returned, it
    classifies the earlier frames and these together.
    """
    temperatures = {int(length): value for length, value in metadata.temperatures.items()}
    calibrated = CalibratedTGC(network, temperatures).eval()
    start = initial_state(network)
    memories = [f"memory{i}" for i in range(len(start.memory))]
    names = ["level", "motion", *memories, "sums", "highest", "frames"]
    batch, frames = torch.export.Dim("batch"), torch.export.Dim("frames", min=1)
    memory = tuple(torch.zeros(1, kept.shape[1], 30, kept.shape[3]) for kept in start.memory)
    program = torch.onnx.export(
        _Step(calibrated).eval(),
        (torch.zeros(2, 144, ROWS, COLUMNS), *start._replace(memory=memory)),
        dynamo=True,
        custom_translation_table={torch.ops.aten.index.Tensor: _gather()},
        verbose=False,
        opset_version=OPSET,
        input_names=["counts", *names],
        output_names=["probabilities", *(f"next_{name}" for name in names)],
        dynamic_shapes={
            "counts": {0: batch, 1: frames},
            "level": {},
            "motion": {},
            "memory": tuple({2: torch.export.Dim(f"kept{i}", min=0)} for i in range(len(memory))),
            "sums": {},
            "highest": {},
            "frames": {},
        },
    )
    assert program is not None
    proto = program.model_proto
    forget_where_it_was_made(proto)
    _describe(proto, metadata, dict(zip(names, _flat(start), strict=True)))
    onnx.checker.check_model(proto)
    path.parent.mkdir(parents=True, exist_ok=True)
    onnx.save(proto, path)


def _describe(proto: onnx.ModelProto, metadata: ModelMetadata, start: dict[str, Tensor]) -> None:
    """Add the metadata, and the state at the start of a touch as the inputs' defaults."""
    # The exporter fixes the state's batch size to one touch; make it the batch size of the windows.
    del proto.graph.value_info[:]
    for entry in proto.graph.input:
        if entry.name not in ("counts", "frames"):
            entry.type.tensor_type.shape.dim[0].dim_param = "touches"
    # An input that has an initializer may be left out (ONNX IR, "default values").
    proto.graph.initializer.extend(
        onnx.numpy_helper.from_array(tensor.numpy(), name) for name, tensor in start.items()
    )
    entry = proto.metadata_props.add()
    entry.key, entry.value = METADATA_KEY, msgspec.json.encode(metadata).decode()


def _gather() -> Callable[..., object]:
    """Return what exports x[index] and x[:, index] as one Gather; the exporter would write four nodes."""
    # Takes a second to import, and only an export needs it.
    from onnxscript import opset20 as op
    from onnxscript.onnx_types import FLOAT, INT64

    def gather(x: FLOAT, indices: Sequence[INT64]) -> FLOAT:
        gathered: FLOAT = op.Gather(x, indices[-1], axis=len(indices) - 1)
        return gathered

    return gather


def _flat(state: TGCState) -> tuple[Tensor, ...]:
    return state.level, state.motion, *state.memory, state.sums, state.highest, state.frames


def forget_where_it_was_made(proto: onnx.ModelProto) -> None:
    """Remove the source files and paths of this machine that the exporter records."""
    for entry in (*proto.graph.node, *proto.graph.value_info, *proto.graph.input, *proto.graph.output):
        del entry.metadata_props[:]
        entry.doc_string = ""
    for tensor in proto.graph.initializer:
        del tensor.metadata_props[:]
    del proto.graph.metadata_props[:]
