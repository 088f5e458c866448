"""Training the challenge's networks: Adam on whole recordings, on one thread, the same for a seed."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import torch
from numpy.typing import NDArray
from torch.nn import functional
from tqdm import tqdm

from docs.studies.report.challenge_hughes import Autoencoder, FrameCodes, HughesNetwork, scaled, step_loss
from model.training.haart import GESTURES, Windows

LEARNING_RATE = 3e-3
BATCH = 32
CROPS = 3
CROP_FRAMES = 144
AUTOENCODER_STEPS = 2000
AUTOENCODER_BATCH = 256
ANSWER_BATCH = 128


def epochs(kind: str, windows: Windows, seed: int, count: int) -> Iterator[HughesNetwork]:
    """Train on windows of counts (N, L, 8, 8) for `count` epochs and yield the network after each."""
    torch.manual_seed(seed)
    rng = torch.Generator().manual_seed(seed)
    counts = torch.from_numpy(windows.counts.astype(np.int16))
    labels = torch.from_numpy(windows.labels)
    network = HughesNetwork(kind, len(GESTURES))
    if isinstance(network.see, FrameCodes):
        _learn_codes(network.see.autoencoder, counts, rng)
    learnt = [parameter for parameter in network.parameters() if parameter.requires_grad]
    optimizer = torch.optim.Adam(learnt, lr=LEARNING_RATE)
    for _ in tqdm(range(count), unit="epoch", desc=f"{kind}, seed {seed}"):
        network.train()
        order = torch.cat([torch.randperm(len(labels), generator=rng) for _ in range(CROPS)])
        for chosen in torch.split(order, BATCH):
            loss = step_loss(network(_crops(counts[chosen], rng)), labels[chosen])
            optimizer.zero_grad()
            loss.backward()  # type: ignore[no-untyped-call]
            optimizer.step()
        yield network.eval()


def answers(network: HughesNetwork, counts: NDArray[np.uint16]) -> NDArray[np.int64]:
    """Return the class named for each window (N,) of counts (N, L, 8, 8)."""
    with torch.no_grad():
        named = [
            network.answer(batch.float()).argmax(dim=1)
            for batch in torch.split(torch.from_numpy(counts.astype(np.int16)), ANSWER_BATCH)
        ]
    together: NDArray[np.int64] = torch.cat(named).numpy()
    return together


def _crops(counts: torch.Tensor, rng: torch.Generator) -> torch.Tensor:
    starts = torch.randint(counts.shape[1] - CROP_FRAMES + 1, (len(counts),), generator=rng)
    cut = [each[start : start + CROP_FRAMES] for each, start in zip(counts, starts.tolist(), strict=True)]
    return torch.stack(cut).float()


def _learn_codes(autoencoder: Autoencoder, counts: torch.Tensor, rng: torch.Generator) -> None:
    frames = counts.flatten(0, 1).flatten(1)
    autoencoder.requires_grad_(True)
    optimizer = torch.optim.Adam(autoencoder.parameters(), lr=LEARNING_RATE)
    for _ in range(AUTOENCODER_STEPS):
        chosen = scaled(frames[torch.randint(len(frames), (AUTOENCODER_BATCH,), generator=rng)].float())
        loss = functional.mse_loss(autoencoder(chosen), chosen)
        optimizer.zero_grad()
        loss.backward()  # type: ignore[no-untyped-call]
        optimizer.step()
    autoencoder.requires_grad_(False)
