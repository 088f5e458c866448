"""The networks whose speed is weighed against their error, each as an ONNX file, in float32 and in int8.

Other people's networks have random weights here, which takes the same time; ours are the shipped file and its
sizes.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import onnx
import torch
from torch import Tensor, nn

from touchd.drivers.frame import COLUMNS, ROWS
from touchd.drivers.recording import Recording
from touchd.model.classifier import Classifier
from touchd.model.settings import LENGTHS
from touchd.model.studies.report import int8
from touchd.model.studies.report.challenge_hughes import AUTOENCODER_RNN, CNN, CRNN, RECURRENT, HughesNetwork
from touchd.model.studies.report.paper_cells import Variant
from touchd.model.studies.report.paper_tgc import PaperSettings, PaperTGC
from touchd.model.studies.report.tables23 import TABLE2, TABLE2_FRAMES
from touchd.model.training.export import OPSET
from touchd.model.training.haart import GESTURES
from touchd.model.training.ship import HAART_MODEL

FLOAT32, INT8 = "float32", "int8"
SHIPPED = "touchd"
OURS, HUGHES = "touchd", "hughes"
"""Families of networks, beside the paper's two variants: ours, and the challenge's."""
PAPER_LENGTHS = (54, 72, 81, 144)
"""The lengths answered by us, and the one that the paper calls 1.5 s."""
PAPER_BLOCKS = 6
VARIANTS: tuple[Variant, ...] = ("printed", "public")
CHALLENGE = {"hughes-cnn": CNN, "hughes-crnn": CRNN, "hughes-autoencoder": AUTOENCODER_RNN}
"""The challenge's networks, by their names in table 1."""


@dataclass(frozen=True, eq=False)
class TimedNetwork:
    """One file to be timed. frames: the window lengths at which it is asked.

    eager: the same network in PyTorch, of others than ours in float32.
    """

    name: str
    family: str
    arithmetic: str
    frames: tuple[int, ...]
    path: Path
    width: int
    blocks: int
    eager: nn.Module | None = None

    @property
    def key(self) -> str:
        """Where its figures stand among the results."""
        return f"front/{self.name}/{self.arithmetic}"


class HughesAnswer(nn.Module):
    """A network of the challenge's as deployed: counts (B, L, 8, 8) to log probabilities (B, classes)."""

    def __init__(self, kind: str) -> None:
        super().__init__()
        self.network = HughesNetwork(kind, len(GESTURES))

    def forward(self, counts: Tensor) -> Tensor:
        """Return (B, classes) log probabilities."""
        return self.network.answer(counts)


def paper_settings() -> list[PaperSettings]:
    """Return the paper's networks: 6 blocks at every length, and those of Table 2, printed and public."""
    shapes = [(frames, PAPER_BLOCKS) for frames in PAPER_LENGTHS]
    shapes += [(TABLE2_FRAMES, blocks) for blocks in TABLE2 if blocks != PAPER_BLOCKS]
    return [PaperSettings(variant, frames, blocks) for variant in VARIANTS for frames, blocks in shapes]


def paper_name(settings: PaperSettings) -> str:
    """Return the name of a network of the paper's: variant, length and blocks."""
    return f"tgc-{settings.variant}-{settings.frames}-frames-{settings.blocks}-blocks"


def hughes_name(system: str, frames: int) -> str:
    """Return the name of a network of the challenge's at one length."""
    return f"{system}-{frames}-frames"


def ours(sizes: Mapping[str, Path], calibration: Sequence[Recording], folder: Path) -> list[TimedNetwork]:
    """Return the shipped network and its sizes, float32 and int8 with scales from the recordings."""
    networks = []
    for name, path in {SHIPPED: HAART_MODEL, **sizes}.items():
        shape = Classifier.load(path).metadata.training["network"]
        width, blocks = shape["width"], shape["blocks"]
        for arithmetic, file in ((FLOAT32, path), (INT8, int8.static(path, calibration, folder))):
            networks.append(TimedNetwork(name, OURS, arithmetic, LENGTHS, file, width, blocks))
    return networks


def papers(settings: PaperSettings, folder: Path) -> list[TimedNetwork]:
    """Return one network of the paper's, float32 and int8."""
    torch.manual_seed(0)
    network = PaperTGC(settings, len(GESTURES)).eval()
    name, frames = paper_name(settings), settings.frames
    return _others(name, settings.variant, frames, network, settings.width, settings.blocks, folder)


def hughes(system: str, frames: int, folder: Path) -> list[TimedNetwork]:
    """Return one network of the challenge's, float32 and int8."""
    torch.manual_seed(0)
    network = HughesAnswer(CHALLENGE[system]).eval()
    return _others(hughes_name(system, frames), HUGHES, frames, network, RECURRENT, 0, folder)


def export(network: nn.Module, frames: int, path: Path) -> None:
    """Write a network that answers at one length as one ONNX file: (1, frames, 8, 8) counts to answers."""
    program = torch.onnx.export(
        network,
        (torch.zeros(1, frames, ROWS, COLUMNS),),
        dynamo=True,
        opset_version=OPSET,
        input_names=["counts"],
        output_names=["answers"],
        verbose=False,
    )
    assert program is not None
    onnx.save(program.model_proto, path)


def _others(
    name: str, family: str, frames: int, network: nn.Module, width: int, blocks: int, folder: Path
) -> list[TimedNetwork]:
    path = folder / f"{name}.onnx"
    export(network, frames, path)
    # Dynamic scales: with random weights, static ones would mean nothing.
    small = int8.dynamic(path, folder)
    return [
        TimedNetwork(name, family, FLOAT32, (frames,), path, width, blocks, network),
        TimedNetwork(name, family, INT8, (frames,), small, width, blocks),
    ]
