"""Trains the detector on random pieces, with rest and noise as the tracker would follow them; resumable."""

import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import torch
import yaml
from numpy.typing import NDArray
from torch import Tensor
from torch.nn import functional
from tqdm import tqdm

from touchd.drivers.frame import FRAME_RATE_HZ
from touchd.drivers.whole_file import whole_file
from touchd.model.adapt.head import GRADIENT_LIMIT, learning_rate_at
from touchd.model.detector import BEGIN_FRAMES, GOES_ON, LIKELY, REST_FRAMES, SHIPPED_DETECTOR, SURE
from touchd.model.training.detector import signals
from touchd.model.training.detector.network import DetectorNetwork
from touchd.model.training.detector.pieces import Composer, Piece
from touchd.model.training.detector.signals import Pad

RECIPE = Path(__file__).with_name("recipe.yaml")
CHECKPOINT_NAME = "detector.pt"
SAVED_EVERY_S = 60.0
QUIET_FRAMES = round(0.8 * FRAME_RATE_HZ)
# Probabilities that stand for the network's own while it is untrained: by the true touches.
TEACHER_TOUCHED, TEACHER_UNTOUCHED = 0.97, 0.03
Ask = Callable[[int, Tensor, Pad], Tensor]
"""From the frame's number, its counts (B, 1, 64) and what is known of the pad to probabilities (B, 1)."""


class DetectorSettings(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Everything that determines a detector except data and code."""

    name: str = "detector-1"
    seed: int = 0
    left_out: tuple[str, ...] = ()
    left_out_study: str = ""
    steps: int = 2000
    batch: int = 8
    learning_rate: float = 3e-3
    own_answers_from: float = 0.6
    """Share of the steps after which rest follows the network's own answers in every third step."""
    average_decay: float = 0.99


class DetectorRecipe(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """The detectors to train. folds: for each further detector, the people held out."""

    name: str
    seed: int
    steps: int
    batch: int
    learning_rate: float
    folds: tuple[tuple[str, ...], ...]

    @classmethod
    def read(cls) -> "DetectorRecipe":
        """Return the shipped detectors' recipe."""
        return msgspec.convert(yaml.safe_load(RECIPE.read_text(encoding="utf-8")), cls)

    def jobs(self) -> dict[Path, DetectorSettings]:
        """Return the settings of each detector by its path in the folder of the model files."""
        base = DetectorSettings(
            name=self.name,
            seed=self.seed,
            steps=self.steps,
            batch=self.batch,
            learning_rate=self.learning_rate,
        )
        others = {"fabric": msgspec.structs.replace(base, left_out_study="third")}
        for number, people in enumerate(self.folds, 1):
            others[f"fold{number}"] = msgspec.structs.replace(base, left_out=people)
        beside = {Path("detector", f"{name}.onnx"): settings for name, settings in others.items()}
        return {Path(SHIPPED_DETECTOR.name): base, **beside}


def train(composer: Composer, settings: DetectorSettings, folder: Path) -> DetectorNetwork:
    """Train, saving in `folder` once a minute and resuming from there; return the averaged network."""
    torch.manual_seed(settings.seed)
    network, average = DetectorNetwork(), DetectorNetwork()
    average.load_state_dict(network.state_dict())
    optimizer = torch.optim.AdamW(network.parameters(), lr=settings.learning_rate, weight_decay=0.01)
    path, step, losses = folder / CHECKPOINT_NAME, 0, []
    if path.exists():
        saved: dict[str, Any] = torch.load(path, weights_only=True)
        step = saved["step"]
        network.load_state_dict(saved["network"])
        average.load_state_dict(saved["average"])
        optimizer.load_state_dict(saved["optimizer"])
        composer.rng = np.random.default_rng([settings.seed, step])
    saved_at = time.monotonic()
    with tqdm(total=settings.steps, initial=step, unit="step", desc=folder.name, mininterval=20) as progress:
        while step < settings.steps:
            for group in optimizer.param_groups:
                group["lr"] = learning_rate_at(step, settings.steps, settings.learning_rate)
            pieces = [composer.piece() for _ in range(settings.batch)]
            is_own = step >= settings.own_answers_from * settings.steps and step % 3 == 0
            asked = None if is_own else teacher(pieces, composer.rng)
            losses.append(_learn(network, optimizer, pieces, asked))
            step += 1
            progress.update()
            _follow(average, network, 1.0 - settings.average_decay if step > 100 else 1.0)
            if step == settings.steps or time.monotonic() - saved_at > SAVED_EVERY_S:
                progress.set_postfix(loss=f"{np.mean(losses[-50:]):.4f}")
                state = {"step": step, "optimizer": optimizer.state_dict()}
                state |= {"network": network.state_dict(), "average": average.state_dict()}
                folder.mkdir(parents=True, exist_ok=True)
                with whole_file(path) as partial:
                    torch.save(state, partial)
                saved_at = time.monotonic()
    return average.eval()


def _follow(average: DetectorNetwork, network: DetectorNetwork, share: float) -> None:
    with torch.no_grad():
        for mean, now in zip(average.parameters(), network.parameters(), strict=True):
            mean.lerp_(now, share)


def _learn(
    network: DetectorNetwork, optimizer: torch.optim.Optimizer, pieces: Sequence[Piece], asked: Ask | None
) -> float:
    """Take a step on some pieces; return the loss. asked: the answers that rest follows; None: its own."""
    counts = torch.from_numpy(np.stack([piece.counts for piece in pieces]))
    targets = torch.from_numpy(np.stack([piece.targets for piece in pieces]))[:, REST_FRAMES:]
    weights = torch.from_numpy(np.stack([piece.weights for piece in pieces]))[:, REST_FRAMES:]
    with torch.no_grad():
        known = followed(counts, asked or own_answers(network, len(pieces)))
        taxels, totals = signals.inputs(counts[:, REST_FRAMES:, None], known)
    losses = functional.binary_cross_entropy_with_logits(network(taxels, totals), targets, reduction="none")
    loss = (losses * weights).sum() / weights.sum()
    optimizer.zero_grad()
    loss.backward()  # type: ignore[no-untyped-call]
    torch.nn.utils.clip_grad_norm_(network.parameters(), GRADIENT_LIMIT)
    optimizer.step()
    return float(loss.detach())


def followed(counts: Tensor, ask: Ask) -> Pad:
    """Return the tracker's state of the pad before each frame from REST_FRAMES on, (B, T, ...).

    counts: (B, T, 64). The rules of `daemon.path.tracker`, for many pads at once.
    """
    B, T = counts.shape[:2]
    pad = signals.begin(counts[:, :REST_FRAMES])
    is_touch = torch.zeros(B, 1)
    above, below = torch.zeros(B, 1), torch.zeros(B, 1)
    known: list[Pad] = []
    for t in range(REST_FRAMES, T):
        known.append(pad)
        now = counts[:, t, None]
        probability = ask(t, now, pad)
        pad = signals.follow(now, pad, ((1.0 - is_touch) * (1.0 - probability))[..., None])
        above = torch.where(probability > LIKELY, above + 1, 0.0)
        below = torch.where(probability < GOES_ON, below + 1, 0.0)
        begins = (above >= BEGIN_FRAMES) | (probability > SURE)
        ends = (is_touch > 0) & (below >= QUIET_FRAMES)
        if ends.any():
            rest = counts[:, t + 1 - REST_FRAMES : t + 1].median(dim=1, keepdim=True).values
            others = pad.levels[:, 1:]
            pad = pad._replace(levels=torch.where(ends[..., None], torch.cat([rest, others], 1), pad.levels))
        is_touch = torch.where(ends, 0.0, torch.where(begins, 1.0, is_touch))
    return Pad(*(torch.stack(each, dim=1) for each in zip(*known, strict=True)))


def teacher(pieces: Sequence[Piece], rng: np.random.Generator) -> Ask:
    """Return answers that follow the true touches, sometimes with a delay."""
    targets = np.stack([piece.targets for piece in pieces])
    late = np.where(rng.random(len(pieces)) < 0.3, rng.integers(1, 40, len(pieces)), 1)
    lasting = np.stack([_after(row, frames) for row, frames in zip(targets, late, strict=True)])
    answers = torch.from_numpy(np.where(lasting, TEACHER_TOUCHED, TEACHER_UNTOUCHED).astype(np.float32))
    return lambda t, _counts, _pad: answers[:, t : t + 1]


def _after(targets: NDArray[np.float32], frames: int) -> NDArray[np.bool_]:
    """Return where a touch has gone on for some frames."""
    since = np.convolve(targets, np.ones(frames), "full")[: len(targets)]
    touched: NDArray[np.bool_] = (since >= frames) & (targets > 0)
    return touched


def own_answers(network: DetectorNetwork, B: int) -> Ask:
    """Return the network's own answers, frame by frame."""
    hidden = torch.zeros(B, network.memory.hidden_size)

    def ask(_t: int, counts: Tensor, pad: Pad) -> Tensor:
        nonlocal hidden
        seen = network.see(*signals.inputs(counts, pad))
        hidden = network.remember(seen, hidden)
        return torch.sigmoid(network.out(torch.cat([seen, hidden], dim=1)))

    return ask
