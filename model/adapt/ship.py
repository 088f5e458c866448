"""An adapted network as a file that the daemon loads; what is there already is never written over."""

import hashlib
import logging
import os
from pathlib import Path

import msgspec

from drivers.errors import TouchdError, os_errors_as
from drivers.frame import FRAME_RATE_HZ
from drivers.whole_file import whole_file
from model.adapt.adapt import Adapted, Pretrained, adapt, prepare
from model.adapt.folder import read_folder
from model.adapt.head import AdaptSettings
from model.classifier import SHIPPED_MODEL, ModelMetadata
from model.settings import LENGTHS, MAX_LENGTH
from model.tgc import TGC
from model.training.checkpoint import code_version, data_hash
from model.training.export import export
from model.training.threads import one_torch_thread

SUFFIX = ".onnx"


class OutputError(TouchdError):
    """The adapted model cannot be written; the message says why and what to do."""


def adapt_folder(extra: Path, output: Path, settings: AdaptSettings, keep_all: bool = False) -> Adapted:
    """Adapt the shipped network to a folder of recordings and write it to `output`, a new .onnx file.

    keep_all: keep the known gestures that the folder lacks. Raises ExtraError, RecordingError, and
    OutputError before any work where `output` cannot be written.
    """
    check_output(output)
    pretrained = Pretrained.shipped()
    recordings = read_folder(extra, pretrained.saved.labels)
    # On one thread sums are the same on every run, and a head is too small to gain by more.
    with one_torch_thread():
        adapted = adapt(pretrained, prepare(pretrained, recordings, settings), settings, keep_all)
    write(pretrained, adapted, output, settings)
    return adapted


def check_output(output: Path) -> None:
    """Raise OutputError unless a new .onnx file can be written there."""
    if output.suffix != SUFFIX:
        raise OutputError(f"{output}: a model's name ends with {SUFFIX}; give one with --output")
    if output.exists():
        raise OutputError(f"{output}: is there already, and is never written over; give another --output")
    if not os.access(output.parent, os.W_OK | os.X_OK):
        raise OutputError(f"{output.parent}: nothing can be written there; give another --output")


def write(pretrained: Pretrained, adapted: Adapted, output: Path, settings: AdaptSettings) -> None:
    """Write the network, with what it is and how good it is, whole or not at all. Raises OutputError."""
    network = TGC(pretrained.saved.settings.network, len(adapted.labels))
    head = {f"dense.{key}": value for key, value in adapted.head.state_dict().items()}
    network.load_state_dict({**pretrained.backbone.state_dict(), **head})
    metadata = ModelMetadata(
        name=output.stem,
        labels=adapted.labels,
        frame_rate_hz=FRAME_RATE_HZ,
        framing="live",
        lengths=LENGTHS,
        max_length=MAX_LENGTH,
        temperatures={str(length): round(value, 4) for length, value in adapted.temperatures.items()},
        training={
            **msgspec.to_builtins(pretrained.saved.settings),
            "adapted": {
                "from_sha256": hashlib.sha256(SHIPPED_MODEL.read_bytes()).hexdigest(),
                "settings": msgspec.to_builtins(settings),
                "participants": len({recording.participant for recording in adapted.recordings}),
                "recordings": len(adapted.recordings),
            },
        },
        code_version=code_version(),
        data_sha256=data_hash(adapted.recordings),
        scores={"adapted": msgspec.to_builtins(adapted.comparison)},
    )
    # The exporter logs at length about a library that is not installed.
    logging.getLogger("torch.onnx._internal.exporter._registration").setLevel(logging.ERROR)
    with (
        os_errors_as(OutputError, f"{output}: cannot be written"),
        whole_file(output, replace=False) as partial,
    ):
        export(network.eval(), metadata, partial)
