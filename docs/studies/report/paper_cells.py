"""The cells of the paper's tables 2 and 3: which of its networks are trained, how long, from which seed."""

from dataclasses import dataclass
from itertools import product
from pathlib import Path
from typing import Literal

import msgspec
import yaml

from docs.studies.report.results import Results
from docs.studies.training.recipe import SettingsError

PREFIX = "paper/"
GRID = Path(__file__).parent / "grid.yaml"
STORED_FOLDER = "report"
"""In the folder of the pages."""
PAPER_EPOCHS = 100

Variant = Literal["public", "printed"]


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
        return f"{_prefix(self.variant, self.blocks, self.frames)}epochs{self.epochs}/seed{self.seed}"


class GridEntry(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Cells that differ in blocks, frames and seeds; all combinations are meant."""

    variant: Variant
    blocks: tuple[int, ...]
    frames: tuple[int, ...]
    epochs: int
    seeds: tuple[int, ...]

    def cells(self) -> list[PaperCell]:
        """Return every combination, seeds first, so that each cell of a table is filled before its spread."""
        combinations = product(self.seeds, self.frames, self.blocks)
        return [
            PaperCell(self.variant, blocks, frames, self.epochs, seed)
            for seed, frames, blocks in combinations
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


def trained_cells(results: Results, variant: Variant, blocks: int, frames: int) -> list[PaperCell]:
    """Return the cells trained longest, one a seed, all for as many epochs; empty when there is none."""
    found = [parse(key) for key in results.keys(_prefix(variant, blocks, frames))]
    longest = max((cell.epochs for cell in found), default=0)
    return [cell for cell in found if cell.epochs == longest]


def trained_networks(results: Results) -> list[tuple[Variant, int, int]]:
    """Return variant, blocks and frames of every trained network: public first, by frames, by blocks."""
    found = {(cell.variant, cell.blocks, cell.frames) for cell in map(parse, results.keys(PREFIX))}
    return sorted(found, key=lambda network: (network[0] != "public", network[2], network[1]))


def parse(key: str) -> PaperCell:
    """Return the cell that a key names."""
    _, variant, blocks, frames, epochs, seed = key.split("/")
    return PaperCell(
        variant="printed" if variant == "printed" else "public",
        blocks=int(blocks.removeprefix("blocks")),
        frames=int(frames.removeprefix("frames")),
        epochs=int(epochs.removeprefix("epochs")),
        seed=int(seed.removeprefix("seed")),
    )


def describe(variant: Variant, blocks: int) -> str:
    """Return which of the paper's networks it is, in words."""
    return f"{variant}, {blocks} block{'s' if blocks > 1 else ''}"


def predictions_path(docs: Path, cell: PaperCell) -> Path:
    """Return where the last epoch's probabilities of the test windows lie: (N, 7) float16, labels (N,)."""
    return docs / STORED_FOLDER / f"{cell.training}-epochs{cell.epochs}.npz"


def layout_path(docs: Path, key: str) -> Path:
    """Return where a representation's layout lies: points (N, 2) float16, labels (N,)."""
    return docs / STORED_FOLDER / f"tsne-{key.removeprefix('representation/').replace('/', '-')}.npz"


def _prefix(variant: Variant, blocks: int, frames: int) -> str:
    return f"{PREFIX}{variant}/blocks{blocks}/frames{frames}/"
