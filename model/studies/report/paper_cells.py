"""The cells of the paper's tables 2 and 3: which of its networks are trained, how long, from which seed."""

import re
from dataclasses import dataclass
from itertools import product
from pathlib import Path
from typing import Literal

import msgspec
import yaml

from touchd.model.studies.report.results import Results
from touchd.model.training.recipe import SettingsError

PREFIX = "paper/"
GRID = Path(__file__).parent / "grid.yaml"
STORED_FOLDER = "report"
"""In the folder of the pages."""
PAPER_EPOCHS = 100

Variant = Literal["public", "printed"]
Network = tuple[Variant, int, int]
"""Variant, blocks and frames of one of the paper's networks."""


@dataclass(frozen=True)
class PaperCell:
    """One network of the paper's, trained for `epochs` from `seed`."""

    variant: Variant
    blocks: int
    frames: int
    epochs: int
    seed: int

    @property
    def training(self) -> str:
        """The training's name. Without the epochs: it is the same one, however long it goes on."""
        return f"{self.variant}-blocks{self.blocks}-frames{self.frames}-seed{self.seed}"

    @property
    def key(self) -> str:
        """The cell's key among the results."""
        network = f"{self.variant}/blocks{self.blocks}/frames{self.frames}"
        return f"{PREFIX}{network}/epochs{self.epochs}/seed{self.seed}"

    def stored(self, docs: Path, kind: str = "npz") -> Path:
        """Return where what is kept of the cell lies.

        npz: the last epoch's probabilities of the test windows, (N, 7) float16, and labels (N,); pt: weights.
        """
        return docs / STORED_FOLDER / f"{self.training}-epochs{self.epochs}.{kind}"


class GridEntry(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Cells that differ in blocks, frames and seeds; all combinations are meant."""

    variant: Variant
    blocks: tuple[int, ...]
    frames: tuple[int, ...]
    epochs: int
    seeds: tuple[int, ...]

    def cells(self) -> list[PaperCell]:
        """Return every combination, seeds first, so that each cell of a table is filled before its spread."""
        return [
            PaperCell(self.variant, blocks, frames, self.epochs, seed)
            for seed, frames, blocks in product(self.seeds, self.frames, self.blocks)
        ]


class Grid(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """whole: what a GPU trains; feasible: what a processor does; in the order in which it is done."""

    learning_rate: float
    batch: int
    bfloat16: bool
    whole: tuple[GridEntry, ...]
    feasible: tuple[GridEntry, ...]


def read_grid(path: Path = GRID) -> Grid:
    """Read the grid; raises SettingsError."""
    try:
        return msgspec.convert(yaml.safe_load(path.read_text(encoding="utf-8")), Grid)
    except (OSError, yaml.YAMLError, msgspec.ValidationError) as error:
        raise SettingsError(f"{path}: {error}") from error


def trained(results: Results) -> dict[Network, list[PaperCell]]:
    """Return the cells of every trained network that were trained longest, one a seed.

    Public networks first, by frames, by blocks.
    """
    networks: dict[Network, list[PaperCell]] = {}
    cells = [parse(key) for key in results.keys(PREFIX)]
    for cell in sorted(cells, key=lambda cell: (cell.variant != "public", cell.frames, cell.blocks)):
        networks.setdefault((cell.variant, cell.blocks, cell.frames), []).append(cell)
    return {
        network: [cell for cell in own if cell.epochs == max(each.epochs for each in own)]
        for network, own in networks.items()
    }


def accuracies(results: Results, cell: PaperCell) -> list[float]:
    """Return the macro accuracy on the test windows after each epoch."""
    measured: list[float] = results.get(cell.key)["accuracies"]
    return measured


def parse(key: str) -> PaperCell:
    """Return the cell that a key names."""
    variant: Variant = "printed" if "/printed/" in key else "public"
    blocks, frames, epochs, seed = map(int, re.findall(r"\d+", key))
    return PaperCell(variant, blocks, frames, epochs, seed)


def describe(variant: Variant, blocks: int) -> str:
    """Return which of the paper's networks it is, in words."""
    return f"{variant}, {blocks} block{'s' if blocks > 1 else ''}"
