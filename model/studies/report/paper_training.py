"""Training the paper's networks as its public code does: Adam, batches of 64, a constant rate.

Source: github.com/Yuanbo2020/TGC, processing.py and 1_run_frames.py. That code keeps the epoch that does best
on the test participants. Here every epoch's test accuracy is kept, so that one training yields both that
figure and the unbiased one, of the last epoch of a number fixed beforehand.
"""

import fcntl
import logging
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor
from torch.nn import functional
from tqdm import tqdm

from touchd.drivers.whole_file import whole_file
from touchd.model.studies.report.paper_cells import Grid, PaperCell
from touchd.model.studies.report.paper_tgc import PaperSettings, PaperTGC
from touchd.model.studies.report.results import Study
from touchd.model.training import haart, metrics
from touchd.model.training.checkpoint import CheckpointError
from touchd.model.training.haart import GESTURES, Windows
from touchd.model.training.train import computes_bfloat16, fastest_device

log = logging.getLogger(__name__)

CHECKPOINT_NAME = "checkpoint.pt"
TEST_BATCH = 256


class PaperTraining:
    """One of the paper's networks in training: weights, optimizer, random states, and each epoch's scores."""

    def __init__(self, cell: PaperCell, grid: Grid, training: Windows, test: Windows, device: str) -> None:
        self.batch = grid.batch
        self.bfloat16 = grid.bfloat16 and computes_bfloat16(device)
        self.device = device
        self.inputs = torch.from_numpy(training.counts.astype(np.float32))
        self.targets = torch.from_numpy(training.labels)
        self.test = test
        torch.manual_seed(cell.seed)
        self.rng = torch.Generator().manual_seed(cell.seed)
        self.network = _network(cell).to(device)
        self.optimizer = torch.optim.Adam(self.network.parameters(), lr=grid.learning_rate)
        self.losses: list[float] = []
        self.accuracies: list[float] = []
        self.seconds = 0.0

    @property
    def epoch(self) -> int:
        """How many epochs are done."""
        return len(self.accuracies)

    def run_epoch(self) -> NDArray[np.float64]:
        """Train on every window once, then return the probabilities (N, 7) of the test windows."""
        began = time.perf_counter()
        self.network.train()
        total = 0.0
        for chosen in torch.split(torch.randperm(len(self.targets), generator=self.rng), self.batch):
            with torch.autocast(self.device, torch.bfloat16, enabled=self.bfloat16):
                logits = self.network(self.inputs[chosen].to(self.device))
            loss = functional.cross_entropy(logits.float(), self.targets[chosen].to(self.device))
            self.optimizer.zero_grad()
            loss.backward()  # type: ignore[no-untyped-call]
            self.optimizer.step()
            total += float(loss.item()) * len(chosen)
        probabilities = answer(self.network, self.test.counts, self.device)
        self.losses.append(total / len(self.targets))
        self.accuracies.append(macro_accuracy(probabilities, self.test.labels))
        self.seconds += time.perf_counter() - began
        return probabilities

    def save(self, path: Path) -> None:
        """Write everything that resuming needs, whole or not at all."""
        path.parent.mkdir(parents=True, exist_ok=True)
        state = {
            "network": self.network.state_dict(),
            "optimizer": self.optimizer.state_dict(),
            "rng": self.rng.get_state(),
            "torch_rng": torch.get_rng_state(),
            "losses": self.losses,
            "accuracies": self.accuracies,
            "seconds": self.seconds,
        }
        with whole_file(path) as partial:
            torch.save(state, partial)

    def resume(self, path: Path) -> None:
        """Resume a saved training; raises CheckpointError."""
        state = _load(path)
        self.network.load_state_dict(state["network"])
        self.optimizer.load_state_dict(state["optimizer"])
        self.rng.set_state(state["rng"])
        torch.set_rng_state(state["torch_rng"])
        self.losses, self.accuracies, self.seconds = state["losses"], state["accuracies"], state["seconds"]

    def finish(self, cell: PaperCell, path: Path) -> None:
        """Train to the cell's last epoch, saving each."""
        with tqdm(total=cell.epochs, initial=self.epoch, unit="epoch", desc=cell.training) as progress:
            while self.epoch < cell.epochs:
                self.run_epoch()
                self.save(path)
                progress.set_postfix(loss=f"{self.losses[-1]:.3f}", test=f"{self.accuracies[-1]:.3f}")
                progress.update()


def train(study: Study, grid: Grid, cell: PaperCell) -> None:
    """Train the cell to its last epoch, from its checkpoint where there is one, and store its results.

    A training that another process is at is left to it. One that has gone on for longer than the cell asks is
    left as it is.
    """
    folder = study.checkpoints / cell.training
    folder.mkdir(parents=True, exist_ok=True)
    with claim(folder) as claimed:
        if not claimed:
            log.warning("%s: another process is training it; left to that one", cell.training)
            return
        torch.set_num_threads(study.threads)
        device = fastest_device()
        training = haart.cut(haart.read_training(study.haart), cell.frames)
        test = haart.cut(haart.read_test(study.haart), cell.frames)
        paper = PaperTraining(cell, grid, training, test, device)
        if (folder / CHECKPOINT_NAME).exists():
            paper.resume(folder / CHECKPOINT_NAME)
        if paper.epoch > cell.epochs:
            log.warning("%s: trained for %d epochs already; left as it is", cell.training, paper.epoch)
            return
        paper.finish(cell, folder / CHECKPOINT_NAME)
    probabilities = answer(paper.network, test.counts, device)
    stored = cell.stored(study.docs)
    stored.parent.mkdir(parents=True, exist_ok=True)
    np.savez_compressed(
        stored, probabilities=probabilities.astype(np.float16), labels=test.labels.astype(np.uint8)
    )
    values = {
        "windows": len(test.labels),
        "parameters": sum(parameter.numel() for parameter in paper.network.parameters()),
        "learning_rate": grid.learning_rate,
        "batch": grid.batch,
        "bfloat16": paper.bfloat16,
        "framing": "published",
        "device": device,
        "losses": [round(loss, 4) for loss in paper.losses],
        "accuracies": [round(accuracy, 5) for accuracy in paper.accuracies],
    }
    study.results.put(cell.key, values, paper.seconds)


def trained(study: Study, cell: PaperCell) -> PaperTGC | None:
    """Return the network of a training, ready to answer; None where its checkpoint is not at this cell.

    Raises CheckpointError.
    """
    path = study.checkpoints / cell.training / CHECKPOINT_NAME
    if not path.exists() or len((state := _load(path))["accuracies"]) != cell.epochs:
        return None
    return _network(cell, state["network"])


def load_kept(docs: Path, cell: PaperCell) -> PaperTGC:
    """Return a network that is kept with the page, in float16, ready to answer in float32."""
    return _network(cell, torch.load(cell.stored(docs, "pt"), map_location="cpu", weights_only=True))


def answer(network: PaperTGC, counts: NDArray[np.uint16], device: str = "cpu") -> NDArray[np.float64]:
    """Return probabilities (N, 7) for windows of counts (N, L, 8, 8)."""
    network.eval()
    with torch.no_grad():
        batches = [
            torch.softmax(network(batch.to(device)), dim=-1).cpu()
            for batch in torch.split(torch.from_numpy(counts.astype(np.float32)), TEST_BATCH)
        ]
    return np.asarray(torch.cat(batches), dtype=np.float64)


def macro_accuracy(probabilities: NDArray[np.float64], labels: NDArray[np.int64]) -> float:
    """Return the accuracy averaged over the gestures, as the paper scores."""
    return metrics.macro_accuracy(probabilities.argmax(axis=1).astype(np.int64), labels, len(GESTURES))


def _network(cell: PaperCell, weights: Mapping[str, Tensor] | None = None) -> PaperTGC:
    network = PaperTGC(PaperSettings(cell.variant, cell.frames, cell.blocks), len(GESTURES))
    if weights is not None:
        network.load_state_dict(weights)
    return network.eval()


def _load(path: Path) -> dict[str, Any]:
    try:
        state: dict[str, Any] = torch.load(path, map_location="cpu", weights_only=True)
        return state
    except Exception as error:  # torch raises many types for a damaged file, some with pages of advice
        raise CheckpointError(f"{path}: not a checkpoint of the report; move it away") from error


@contextmanager
def claim(folder: Path) -> Iterator[bool]:
    """Give whether this process alone may train in the folder, as long as this lasts."""
    with open(folder / "lock", "w", encoding="utf-8") as lock:
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            yield False
            return
        yield True
