"""The paper's table 3, its network trained as in its code: `python -m touchd.model.studies paper`.

Adam, batches of 64, a constant rate (github.com/Yuanbo2020/TGC, processing.py and 1_run_frames.py). That code
keeps the epoch that scores best on the test participants. The page shows the last epoch of a number fixed
beforehand, which is unbiased; every epoch's test accuracy is stored.
"""

import re
import sys
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch.nn import functional
from tqdm import tqdm

from touchd.drivers.recording import Recording
from touchd.drivers.whole_file import whole_file
from touchd.model.classifier import Classifier
from touchd.model.studies.checks import evaluate
from touchd.model.studies.checks.evaluate import REPORTED_LENGTHS
from touchd.model.studies.folders import study_parser
from touchd.model.studies.marked import fill, table
from touchd.model.studies.paper_network import PaperSettings, PaperTGC, Variant
from touchd.model.studies.published import TABLE3
from touchd.model.studies.results import STORED, Results, mean_percent
from touchd.model.training import haart, metrics
from touchd.model.training.checkpoint import CheckpointError
from touchd.model.training.haart import GESTURES, Windows
from touchd.model.training.train import computes_bfloat16, fastest_device
from touchd.model.training.weights import touchd_1_files

FILE = STORED / "paper.json"
CHECKPOINT_NAME = "checkpoint.pt"
PAPER_EPOCHS = 100
LEARNING_RATE = 1e-4
BATCH = 64
TEST_BATCH = 256
FRAMINGS = ("published", "realigned")


@dataclass(frozen=True)
class PaperCell:
    """One of the paper's networks, trained for `epochs` from `seed`."""

    variant: Variant
    blocks: int
    frames: int
    epochs: int
    seed: int

    @property
    def training(self) -> str:
        """The training's name, without the epochs, so that it can be continued."""
        return f"{self.variant}-blocks{self.blocks}-frames{self.frames}-seed{self.seed}"

    @property
    def key(self) -> str:
        """The cell's key among the results."""
        network = f"{self.variant}/blocks{self.blocks}/frames{self.frames}"
        return f"{network}/epochs{self.epochs}/seed{self.seed}"

    @classmethod
    def parse(cls, key: str) -> "PaperCell":
        """Return the cell with that key."""
        blocks, frames, epochs, seed = map(int, re.findall(r"\d+", key))
        return cls("printed" if key.startswith("printed") else "public", blocks, frames, epochs, seed)


class PaperTraining:
    """One of the paper's networks in training: weights, optimizer, random states, and each epoch's scores."""

    def __init__(self, cell: PaperCell, training: Windows, test: Windows, device: str) -> None:
        self.bfloat16 = computes_bfloat16(device)
        self.device = device
        self.inputs = torch.from_numpy(training.counts.astype(np.float32))
        self.targets = torch.from_numpy(training.labels)
        self.test = test
        torch.manual_seed(cell.seed)
        self.rng = torch.Generator().manual_seed(cell.seed)
        self.network = PaperTGC(PaperSettings(cell.variant, cell.frames, cell.blocks), len(GESTURES))
        self.network.to(device)
        self.optimizer = torch.optim.Adam(self.network.parameters(), lr=LEARNING_RATE)
        self.accuracies: list[float] = []
        self.seconds = 0.0

    @property
    def epoch(self) -> int:
        """Number of epochs done."""
        return len(self.accuracies)

    def run_epoch(self) -> NDArray[np.float64]:
        """Train on every window once, then return the probabilities (N, 7) of the test windows."""
        began = time.perf_counter()
        self.network.train()
        for chosen in torch.split(torch.randperm(len(self.targets), generator=self.rng), BATCH):
            with torch.autocast(self.device, torch.bfloat16, enabled=self.bfloat16):
                logits = self.network(self.inputs[chosen].to(self.device))
            loss = functional.cross_entropy(logits.float(), self.targets[chosen].to(self.device))
            self.optimizer.zero_grad()
            loss.backward()  # type: ignore[no-untyped-call]
            self.optimizer.step()
        probabilities = answer(self.network, self.test.counts, self.device)
        self.accuracies.append(macro_accuracy(probabilities.argmax(axis=1), self.test.labels))
        self.seconds += time.perf_counter() - began
        return probabilities

    def save(self, path: Path) -> None:
        """Atomically write the whole state."""
        path.parent.mkdir(parents=True, exist_ok=True)
        state = {
            "network": self.network.state_dict(),
            "optimizer": self.optimizer.state_dict(),
            "rng": self.rng.get_state(),
            "torch_rng": torch.get_rng_state(),
            "accuracies": self.accuracies,
            "seconds": self.seconds,
        }
        with whole_file(path) as partial:
            torch.save(state, partial)

    def resume(self, path: Path) -> None:
        """Continue a saved training; raises CheckpointError."""
        state = _load(path)
        self.network.load_state_dict(state["network"])
        self.optimizer.load_state_dict(state["optimizer"])
        self.rng.set_state(state["rng"])
        torch.set_rng_state(state["torch_rng"])
        self.accuracies, self.seconds = state["accuracies"], state["seconds"]

    def finish(self, cell: PaperCell, path: Path) -> None:
        """Train up to the cell's last epoch, and save after each."""
        with tqdm(total=cell.epochs, initial=self.epoch, unit="epoch", desc=cell.training) as progress:
            while self.epoch < cell.epochs:
                self.run_epoch()
                self.save(path)
                progress.set_postfix(test=f"{self.accuracies[-1]:.3f}")
                progress.update()


def main(arguments: Sequence[str]) -> int:
    """Train the networks asked for, then fill the tables from all stored results; returns 0."""
    what = "Trains the paper's network with --train; fills its table in report.md from the stored results."
    parser = study_parser("paper", what, "haart", "docs")
    parser.add_argument("--train", choices=("public", "printed"), help="the variant to train")
    several: dict[str, Any] = {"type": int, "nargs": "+", "metavar": "N"}
    parser.add_argument("--blocks", **several, default=[6], help="encoder blocks, one training each (6)")
    parser.add_argument("--frames", **several, default=[144], help="window lengths, one training each (144)")
    parser.add_argument("--seed", **several, default=[0], help="seeds, one training each (0)")
    parser.add_argument("--epochs", type=int, default=PAPER_EPOCHS, help="(%(default)s)")
    parser.add_argument("--runs", type=Path, default=Path("runs"), help="folder for checkpoints (runs)")
    parser.add_argument("--threads", type=int, default=2, help="processor threads without a GPU (2)")
    options = parser.parse_args(arguments)
    results = Results(FILE)
    if options.train:
        torch.set_num_threads(options.threads)
        training, test = haart.read_training(options.haart), haart.read_test(options.haart)
        score_ours(results, test)
        for seed, frames, blocks in product(options.seed, options.frames, options.blocks):
            cell = PaperCell(options.train, blocks, frames, options.epochs, seed)
            if not results.has(cell.key):
                train(results, cell, training, test, options.runs / "paper")
    page = options.docs / "report.md"
    fill(page, tables(results))
    sys.stdout.write(f"{page}\n")
    return 0


def train(
    results: Results, cell: PaperCell, training: Sequence[Recording], test: Sequence[Recording], runs: Path
) -> None:
    """Train the cell to its last epoch, from its checkpoint if there is one, and store its results.

    Raises CheckpointError for a damaged checkpoint, or one that is past the cell's last epoch.
    """
    path = runs / cell.training / CHECKPOINT_NAME
    windows = haart.cut(test, cell.frames)
    paper = PaperTraining(cell, haart.cut(training, cell.frames), windows, fastest_device())
    if path.exists():
        paper.resume(path)
    if paper.epoch > cell.epochs:
        raise CheckpointError(f"{path}: trained for {paper.epoch} epochs already; ask for as many, or more")
    paper.finish(cell, path)
    named = answer(paper.network, windows.counts, paper.device).argmax(axis=1)
    values = {
        "windows": len(windows.labels),
        "parameters": sum(parameter.numel() for parameter in paper.network.parameters()),
        "learning_rate": LEARNING_RATE,
        "batch": BATCH,
        "bfloat16": paper.bfloat16,
        "device": paper.device,
        "accuracies": [round(accuracy, 5) for accuracy in paper.accuracies],
        "answers": "".join(map(str, named.tolist())),
    }
    results.put(cell.key, values, paper.seconds)


def answer(network: PaperTGC, counts: NDArray[np.uint16], device: str = "cpu") -> NDArray[np.float64]:
    """Return probabilities (N, 7) for windows of counts (N, L, 8, 8)."""
    network.eval()
    with torch.no_grad():
        batches = [
            torch.softmax(network(batch.to(device)), dim=-1).cpu()
            for batch in torch.split(torch.from_numpy(counts.astype(np.float32)), TEST_BATCH)
        ]
    return np.asarray(torch.cat(batches), dtype=np.float64)


def macro_accuracy(named: NDArray[np.int64], labels: NDArray[np.int64]) -> float:
    """Return the accuracy of answers (N,) to windows (N,), averaged over the gestures as in the paper."""
    return metrics.macro_accuracy(named, labels, len(GESTURES))


def score_ours(results: Results, test: Sequence[Recording]) -> None:
    """Store touchd-1's accuracies over the same windows, in both framings, where they are missing."""
    recordings = {"published": test, "realigned": haart.realigned(test)}
    classifiers = [Classifier.load(path) for path in touchd_1_files()]
    for framing, frames in product(FRAMINGS, REPORTED_LENGTHS):
        if results.has(our_key(framing, frames)):
            continue
        began = time.perf_counter()
        scores = [evaluate.score([(each, recordings[framing])], frames) for each in classifiers]
        accuracies = [round(score.accuracy, 5) for score in scores]
        values = {"windows": scores[0].windows, "accuracies": accuracies}
        results.put(our_key(framing, frames), values, time.perf_counter() - began)


def our_key(framing: str, frames: int) -> str:
    """Return the key of touchd-1's scores."""
    return f"ours/{framing}/frames{frames}"


def trained(results: Results) -> list[PaperCell]:
    """Return the cells of the paper's networks that were trained here."""
    return [PaperCell.parse(key) for key in results.find() if not key.startswith("ours/")]


def tables(results: Results) -> dict[str, str]:
    """Return table 3, each row with the network closest to the paper's that was trained here."""
    cells = trained(results)
    by_length = [
        (
            frames,
            TABLE3.get(frames, ""),
            *_row(results, [cell for cell in cells if cell.frames == frames]),
            *(mean_percent(results.get(our_key(framing, frames))["accuracies"]) for framing in FRAMINGS),
        )
        for frames in REPORTED_LENGTHS
    ]
    headings = ("frames", "printed", "blocks / epochs", "its code", "touchd-1", "touchd-1, realigned")
    return {"table3": table(headings, by_length)}


def _row(results: Results, cells: Sequence[PaperCell]) -> tuple[str, ...]:
    """Return what was trained, and its accuracy after the last epoch, over all its seeds."""
    public = [cell for cell in cells if cell.variant == "public"]
    if not public:
        return "not trained", ""
    blocks = max((cell.blocks for cell in public if cell.blocks <= 6), default=public[0].blocks)
    own = [cell for cell in public if cell.blocks == blocks]
    epochs = max(cell.epochs for cell in own)
    curves = [results.get(cell.key)["accuracies"] for cell in own if cell.epochs == epochs]
    return f"{blocks} / {epochs}", mean_percent([curve[-1] for curve in curves])


def _load(path: Path) -> Mapping[str, Any]:
    try:
        state: dict[str, Any] = torch.load(path, map_location="cpu", weights_only=True)
        return state
    except Exception as error:  # torch raises many types for a damaged file, some with pages of advice
        raise CheckpointError(f"{path}: not a checkpoint of this study; move it away") from error
