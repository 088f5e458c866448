"""Writes an adapted network as a model file; an existing file is never overwritten."""

import hashlib
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import msgspec
import onnx
from torch import nn

from touchd.drivers.errors import os_errors_as
from touchd.drivers.whole_file import whole_file
from touchd.model.adapt.adapt import Adapted, Pretrained, adapt
from touchd.model.adapt.folder import NO_LABELS, read_all
from touchd.model.adapt.head import AdaptSettings
from touchd.model.adapt.optimise import one_torch_thread
from touchd.model.adapt.output import OutputError, check_output, code_version, data_hash, model_name
from touchd.model.classifier import METADATA_KEY, SHIPPED_MODEL, Classifier, ModelMetadata

SETTINGS = AdaptSettings()


def adapt_folder(
    extra: Path, output: Path, keep_all: bool = False, labels: Mapping[str, str] = NO_LABELS
) -> Adapted:
    """Adapt the shipped network to a folder of recordings and write it to `output`, a new .onnx file.

    keep_all: keep the known gestures that the folder lacks. labels: see `read_all`. Raises
    ExtraError; raises OutputError before any work if `output` cannot be written.
    """
    check_output(output)
    pretrained = Pretrained.shipped()
    recordings, passed_over = read_all(extra, pretrained.labels, keep_all, labels)
    # One thread makes sums reproducible; a head is too small for more.
    with one_torch_thread():
        adapted = adapt(pretrained, recordings, SETTINGS, keep_all)
    write(adapted, output)
    return replace(adapted, passed_over=passed_over)


def write(adapted: Adapted, output: Path) -> None:
    """Atomically write the model with its metadata and scores; raises OutputError."""
    shipped = Classifier.load().metadata
    origin = {
        "from_sha256": hashlib.sha256(SHIPPED_MODEL.read_bytes()).hexdigest(),
        "settings": msgspec.to_builtins(SETTINGS),
        "participants": len({recording.participant for recording in adapted.recordings}),
        "recordings": len(adapted.recordings),
    }
    metadata = msgspec.structs.replace(
        shipped,
        name=model_name(output),
        labels=adapted.labels,
        training={**shipped.training, "adapted": origin},
        code_version=code_version(),
        data_sha256=data_hash(adapted.recordings),
        scores={"adapted": msgspec.to_builtins(adapted.comparison)},
    )
    proto = grafted(SHIPPED_MODEL, adapted.head, metadata)
    with (
        os_errors_as(OutputError, f"{output}: cannot be written"),
        whole_file(output, replace=False) as partial,
    ):
        onnx.save(proto, partial)


def grafted(model: Path, head: nn.Sequential, metadata: ModelMetadata) -> onnx.ModelProto:
    """Return a copy of a model file with an adapted head, which keeps the file's temperatures."""
    proto = onnx.load(model)
    values = {f"calibrated.network.dense.{name}": value for name, value in head.state_dict().items()}
    tensors = {tensor.name: tensor for tensor in proto.graph.initializer}
    for name, value in values.items():
        tensors[name].CopyFrom(onnx.numpy_helper.from_array(value.numpy(), name))
    proto.graph.output[0].type.tensor_type.shape.dim[1].dim_value = len(metadata.labels)
    (entry,) = (entry for entry in proto.metadata_props if entry.key == METADATA_KEY)
    entry.value = msgspec.json.encode(metadata).decode()
    onnx.checker.check_model(proto)
    return proto
