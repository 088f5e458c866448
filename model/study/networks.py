"""The networks whose speed is weighed against their error, each as an ONNX file, in float32 and in int8.

The paper's have random weights here, which take as long as any; ours are the shipped file and its sizes.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import torch

from drivers.recording import Recording
from model import quantize
from model.classifier import SHIPPED_MODEL
from model.haart import GESTURES
from model.paper_tgc import PaperSettings, PaperTGC
from model.quantize import FLOAT32
from model.settings import LENGTHS
from model.speed import export_paper
from model.study import table2

INT8 = "int8"
SHIPPED = "touchd"
PAPER_LENGTHS = (54, 72, 81, 144)
"""The lengths answered by us, and the one that the paper calls 1.5 s."""
PAPER_BLOCKS = 6


@dataclass(frozen=True, eq=False)
class Network:
    """One file to be timed. frames: the window lengths at which it is asked.

    eager: the same network in PyTorch, only of the paper's in float32.
    """

    name: str
    arithmetic: str
    frames: tuple[int, ...]
    path: Path
    paper: PaperSettings | None = None
    eager: PaperTGC | None = None

    @property
    def key(self) -> str:
        """Where its figures stand among the results."""
        return f"front/{self.name}/{self.arithmetic}"


def paper_settings() -> list[PaperSettings]:
    """Return the paper's networks: 6 blocks at every length, and those of Table 2, printed and public."""
    shapes = [(frames, PAPER_BLOCKS) for frames in PAPER_LENGTHS]
    shapes += [(table2.FRAMES, blocks) for blocks in table2.PAPER if blocks != PAPER_BLOCKS]
    return [
        PaperSettings(variant, frames, blocks)
        for variant in ("printed", "public")
        for frames, blocks in shapes
    ]


def paper_name(settings: PaperSettings) -> str:
    """Return the name of a network of the paper's: variant, length and blocks."""
    return f"tgc-{settings.variant}-{settings.frames}-frames-{settings.blocks}-blocks"


def ours(sizes: Mapping[str, Path], calibration: Sequence[Recording], folder: Path) -> list[Network]:
    """Return the shipped network and its sizes, float32 and int8 with scales from the recordings."""
    networks = []
    for name, path in {SHIPPED: SHIPPED_MODEL, **sizes}.items():
        small = quantize.convert(path, "int8 static", calibration, folder)
        networks += [Network(name, FLOAT32, LENGTHS, path), Network(name, INT8, LENGTHS, small)]
    return networks


def papers(settings: PaperSettings, folder: Path) -> list[Network]:
    """Return one network of the paper's, float32 and int8.

    Nearly all of its work is in linear layers, so its int8 finds the scales anew for each answer.
    """
    torch.manual_seed(0)
    network = PaperTGC(settings, len(GESTURES)).eval()
    name = paper_name(settings)
    path = folder / f"{name}.onnx"
    export_paper(network, path)
    small = quantize.convert(path, "int8 dynamic", (), folder)
    return [
        Network(name, FLOAT32, (settings.frames,), path, settings, network),
        Network(name, INT8, (settings.frames,), small, settings),
    ]
