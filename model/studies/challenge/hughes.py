"""Hughes and others' networks: a CNN, a CNN with a recurrent end (CRNN), and an autoencoder with an RNN.

D. Hughes, A. Krauthammer, N. Correll, "Recognizing Social Touch Gestures using Recurrent and Convolutional
Neural Networks", ICRA 2017, pages 2315 to 2321. From its abstract: the three kinds of network, on raw frames,
which answer 6 to 9 times a second. From Albawi et al. 2018 (doi 10.1155/2018/6973103), table 4: the CNN takes
45 frames of 8 x 8.

Written without the paper's full text; widths, scale of the counts, normalisation, dropout and training are
our choice. All three answer every 9 frames. A window's answer is the last one of a recurrent network, and the
mean over the CNN's 45-frame views, so that one network serves every length.
"""

import math
from collections.abc import Iterator

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn
from torch.nn import functional
from tqdm import tqdm

from touchd.drivers.frame import COLUMNS, ROWS
from touchd.model.training.haart import GESTURES, Windows

STEP_FRAMES = 9
VIEW_STEPS = 5
FILTERS = (16, 32)
RECURRENT = 64
CODE = 8
DROPOUT = 0.5
LIGHT_COUNTS = 20.0
LEARNING_RATE = 3e-3
BATCH = 32
CROPS = 3
CROP_FRAMES = 144
AUTOENCODER_STEPS = 2000
AUTOENCODER_BATCH = 256
ANSWER_BATCH = 128
CNN, CRNN, AUTOENCODER_RNN = "CNN", "CRNN", "Autoencoder-RNN"


def scaled(counts: Tensor) -> Tensor:
    """Map counts (0 to 1023) to 0 to 4.6: linear for light pressure, logarithmic for hard."""
    return torch.asinh(counts / LIGHT_COUNTS)


class FrameFilters(nn.Module):
    """Two layers of 3 x 3 x 3 filters: (B, L, 8, 8) to (B, S, 128), a step S every 9 frames."""

    width = FILTERS[-1] * 4

    def __init__(self) -> None:
        super().__init__()
        first, second = FILTERS
        self.layers = nn.Sequential(
            nn.Conv3d(1, first, 3, stride=(3, 1, 1), padding=(0, 1, 1)),
            nn.BatchNorm3d(first),
            nn.ReLU(),
            nn.MaxPool3d((1, 2, 2)),
            nn.Conv3d(first, second, 3, stride=(3, 1, 1), padding=(0, 1, 1)),
            nn.BatchNorm3d(second),
            nn.ReLU(),
            nn.MaxPool3d((1, 2, 2)),
        )

    def forward(self, frames: Tensor) -> Tensor:
        """Return the filters' output at each step (B, S, 128)."""
        return torch.as_tensor(self.layers(frames[:, None])).transpose(1, 2).flatten(2)


class Autoencoder(nn.Module):
    """Encodes a frame of 64 taxels as 8 numbers, and decodes it."""

    def __init__(self) -> None:
        super().__init__()
        taxels = ROWS * COLUMNS
        self.encoder = nn.Sequential(nn.Linear(taxels, 32), nn.ReLU(), nn.Linear(32, CODE))
        self.decoder = nn.Sequential(nn.Linear(CODE, 32), nn.ReLU(), nn.Linear(32, taxels))

    def forward(self, frames: Tensor) -> Tensor:
        """Return frames (N, 64) reconstructed from their codes."""
        return torch.as_tensor(self.decoder(self.encoder(frames)))


class FrameCodes(nn.Module):
    """The codes of 9 frames side by side, (B, L, 8, 8) to (B, S, 72), by an autoencoder trained before."""

    width = STEP_FRAMES * CODE

    def __init__(self) -> None:
        super().__init__()
        self.autoencoder = Autoencoder().requires_grad_(False)

    def forward(self, frames: Tensor) -> Tensor:
        """Return the codes at each step (B, S, 72)."""
        whole = frames[:, : frames.shape[1] // STEP_FRAMES * STEP_FRAMES]
        codes = self.autoencoder.encoder(whole.flatten(2))
        return torch.as_tensor(codes.unflatten(1, (-1, STEP_FRAMES)).flatten(2))


class Views(nn.Module):
    """A convolution over 5 steps, 45 frames: (B, S, width) to logits (B, S - 4, classes)."""

    def __init__(self, width: int, classes: int) -> None:
        super().__init__()
        self.look = nn.Conv1d(width, RECURRENT, VIEW_STEPS)
        self.classify = nn.Sequential(nn.ReLU(), nn.Dropout(DROPOUT), nn.Linear(RECURRENT, classes))

    def forward(self, steps: Tensor) -> Tensor:
        """Return each view's logits."""
        return torch.as_tensor(self.classify(self.look(steps.transpose(1, 2)).transpose(1, 2)))


class Recurrence(nn.Module):
    """An LSTM over all steps: (B, S, width) to logits (B, S, classes)."""

    def __init__(self, width: int, classes: int) -> None:
        super().__init__()
        self.follow = nn.LSTM(width, RECURRENT, batch_first=True)
        self.classify = nn.Sequential(nn.Dropout(DROPOUT), nn.Linear(RECURRENT, classes))

    def forward(self, steps: Tensor) -> Tensor:
        """Return each step's logits."""
        return torch.as_tensor(self.classify(self.follow(steps)[0]))


class HughesNetwork(nn.Module):
    """One of the three: counts (B, L, 8, 8) of at least 45 frames to logits at each step (B, S, classes)."""

    def __init__(self, kind: str, classes: int) -> None:
        super().__init__()
        self.kind = kind
        self.see = FrameCodes() if kind == AUTOENCODER_RNN else FrameFilters()
        end = Views if kind == CNN else Recurrence
        self.end = end(self.see.width, classes)

    def forward(self, counts: Tensor) -> Tensor:
        """Return the logits at each step."""
        return torch.as_tensor(self.end(self.see(scaled(counts))))

    def answer(self, counts: Tensor) -> Tensor:
        """Return each window's log probabilities (B, classes)."""
        steps = torch.log_softmax(self(counts), dim=-1)
        return steps.mean(dim=1) if self.kind == CNN else steps[:, -1]


def epochs(kind: str, windows: Windows, seed: int, count: int) -> Iterator[HughesNetwork]:
    """Train on windows of counts (N, L, 8, 8) for `count` epochs; yield the network after each.

    The CNN's learning rate falls to zero. At a constant rate the running statistics of its batch
    normalisation lag behind its weights: one of three seeds then ended at 49 %, and at 69 % with the batches'
    own statistics.
    """
    torch.manual_seed(seed)
    rng = torch.Generator().manual_seed(seed)
    counts = torch.from_numpy(windows.counts.astype(np.int16))
    labels = torch.from_numpy(windows.labels)
    network = HughesNetwork(kind, len(GESTURES))
    if isinstance(network.see, FrameCodes):
        _learn_codes(network.see.autoencoder, counts, rng)
    learnt = [parameter for parameter in network.parameters() if parameter.requires_grad]
    optimizer = torch.optim.Adam(learnt, lr=LEARNING_RATE)
    steps = count * math.ceil(CROPS * len(labels) / BATCH)
    rate = torch.optim.lr_scheduler.LambdaLR(
        optimizer, lambda step: 0.5 + 0.5 * math.cos(math.pi * step / steps) if kind == CNN else 1.0
    )
    for _ in tqdm(range(count), unit="epoch", desc=f"{kind}, seed {seed}"):
        network.train()
        order = torch.cat([torch.randperm(len(labels), generator=rng) for _ in range(CROPS)])
        for chosen in torch.split(order, BATCH):
            logits = network(_crops(counts[chosen], rng))  # (B, S, classes); every step is trained
            expected = labels[chosen].repeat_interleave(logits.shape[1])
            loss = functional.cross_entropy(logits.flatten(0, 1), expected)
            optimizer.zero_grad()
            loss.backward()  # type: ignore[no-untyped-call]
            optimizer.step()
            rate.step()
        yield network.eval()


def answers(network: HughesNetwork, counts: NDArray[np.uint16]) -> NDArray[np.int64]:
    """Return the likeliest class (N,) of windows of counts (N, L, 8, 8)."""
    with torch.no_grad():
        named = [
            network.answer(batch.float()).argmax(dim=1)
            for batch in torch.split(torch.from_numpy(counts.astype(np.int16)), ANSWER_BATCH)
        ]
    return np.asarray(torch.cat(named))


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
