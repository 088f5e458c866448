"""Refines trained networks on a CPU: trains their encoder and dense layers, on windows that are drawn once.

The stem and the gated convolutions take most of a step's time and need no further training. So each window
passes through them only once.
"""

import copy
from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import cast

import msgspec
import torch
from torch import Tensor, nn
from torch.nn import functional
from tqdm import tqdm

from touchd.drivers.frame import OTHER
from touchd.drivers.recording import Recording
from touchd.model.adapt.adapt import code_version, data_hash
from touchd.model.adapt.head import GRADIENT_LIMIT, learning_rate_at
from touchd.model.tgc import TGC
from touchd.model.training import checkpoint
from touchd.model.training.calibrate import IMPOSSIBLE
from touchd.model.training.checkpoint import Checkpoint
from touchd.model.training.recipe import Job
from touchd.model.training.settings import TrainSettings
from touchd.model.training.touches import Touches, TouchSampler
from touchd.model.training.train import CHECKPOINT_NAME
from touchd.model.training.windows import learns

SOURCES = (
    "caress.py",
    "contacts.py",
    "haart.py",
    "passing.py",
    "refine.py",
    "settings.py",
    "touches.py",
    "unknown.py",
    "windows.py",
)
BATCH = 32
# Mixtures on which each step compares the network with the first one.
MIXED = 32
# The logit of a new label begins this far below the mean of the others.
BEGINS_BELOW = 2.0


@dataclass(frozen=True, eq=False)
class Drawn:
    """Drawn windows as the upper layers see them.

    frames: (M, T, width) float16, what the gated convolutions return. lengths, weights: (M, K).
    targets: (M, K, classes). possible: (M, classes). taught: (M,), the weight of the first network's answers
    in the targets; 0 where they are to be corrected.
    """

    frames: Tensor
    lengths: Tensor
    weights: Tensor
    targets: Tensor
    possible: Tensor
    taught: Tensor

    def of(self, chosen: Tensor) -> "Drawn":
        return Drawn(
            self.frames[chosen].float(),
            self.lengths[chosen],
            self.weights[chosen],
            self.targets[chosen],
            self.possible[chosen],
            self.taught[chosen],
        )


def extended(first: Checkpoint, labels: Sequence[str]) -> TGC:
    """Return a network with a row for each label; that of a new label begins below the mean of the others."""
    old = first.build()
    network = TGC(first.settings.network, len(labels))
    weights = dict(first.network)
    last = cast(nn.Linear, old.dense[-1])
    name = f"dense.{len(old.dense) - 1}"
    rows = [first.labels.index(label) if label in first.labels else None for label in labels]
    mean, low = last.weight.detach().mean(dim=0), last.bias.detach().mean() - BEGINS_BELOW
    weights[f"{name}.weight"] = torch.stack([mean if r is None else last.weight.detach()[r] for r in rows])
    weights[f"{name}.bias"] = torch.stack([low if r is None else last.bias.detach()[r] for r in rows])
    network.load_state_dict(weights)
    return network


def refine(recordings: Sequence[Recording], job: Job, first: Checkpoint, runs: Path) -> Checkpoint:
    """Refine the network that a job begins from, and save the result in `runs`.

    The weights of several trainings are averaged: as all begin from one network, they end in one basin
    (Wortsman et al., "Model soups", ICML 2022).
    recordings: known gestures, then those of the label `other`.
    """
    own = job.settings
    assert own.refined is not None
    labels = (*first.labels, OTHER) if OTHER not in first.labels else first.labels
    network = extended(first, labels)
    learnt = [_run(recordings, network, labels, own, number) for number in range(own.refined.runs)]
    saved = Checkpoint(
        settings=own,
        labels=labels,
        step=own.steps,
        network=kept(learnt, network, job.keeps, len(first.labels)),
        training={},
        code_version=code_version(*(Path(__file__).with_name(name) for name in SOURCES)),
        data_sha256=data_hash(recording for recording in recordings if learns(own, recording)),
    )
    checkpoint.save(saved, runs / job.name / CHECKPOINT_NAME)
    return saved


def _run(
    recordings: Sequence[Recording], network: TGC, labels: Sequence[str], settings: TrainSettings, number: int
) -> dict[str, Tensor]:
    own = msgspec.structs.replace(settings, seed=settings.seed + number)
    torch.manual_seed(own.seed)
    drawn = draw(TouchSampler(recordings, labels, own), network, own)
    return _learn(network, drawn, own)


@torch.no_grad()
def draw(sampler: TouchSampler, network: TGC, own: TrainSettings) -> Drawn:
    """Draw windows, and pass them through the layers that do not learn."""
    assert own.refined is not None
    network.eval()
    parts: list[Drawn] = []
    for _ in tqdm(range(own.refined.windows // BATCH), desc="drawing", mininterval=10.0):
        touches = sampler.draw(BATCH)
        frames = network.motion(network.stem(touches.counts))
        targets = _taught(network, frames, touches)
        drawn = (touches.lengths, touches.weights, targets, touches.possible, touches.taught)
        parts.append(Drawn(frames.half(), *drawn))
    return Drawn(*(torch.cat([getattr(part, each.name) for part in parts]) for each in fields(Drawn)))


def _taught(network: TGC, frames: Tensor, touches: Touches) -> Tensor:
    """Return the targets, blended with the network's own answers where the gesture is known."""
    logits = network.answers(network.encoder(frames), touches.lengths)
    is_other = torch.zeros(logits.shape[-1], dtype=torch.bool)
    is_other[-1] = True
    logits = logits.masked_fill(is_other | ~touches.possible[:, None], IMPOSSIBLE)
    unknown = touches.unknown[:, None, None]
    teacher = (1.0 - unknown) * torch.softmax(logits, dim=-1) + unknown * is_other
    return torch.lerp(touches.targets, teacher, touches.taught[:, None, None])


def _learn(network: TGC, drawn: Drawn, own: TrainSettings) -> dict[str, Tensor]:
    """Train the encoder and the dense layers; return the network's weights, averaged over the last steps."""
    assert own.refined is not None
    first, network = network, copy.deepcopy(network).train()
    like_first = torch.nonzero(drawn.taught > 0.0).flatten()
    for layers in (network.stem, network.motion):
        layers.requires_grad_(False)
    learning = [weight for weight in network.parameters() if weight.requires_grad]
    optimizer = torch.optim.AdamW(learning, weight_decay=own.weight_decay)
    average = [weight.detach().clone() for weight in learning]
    order = torch.randperm(len(drawn.frames))
    progress = tqdm(range(own.steps), desc=f"{own.name}, seed {own.seed}", mininterval=10.0)
    for step in progress:
        if len(order) < own.batch:
            order = torch.randperm(len(drawn.frames))
        chosen, order = order[: own.batch], order[own.batch :]
        loss = _loss(network, drawn.of(chosen), own.label_smoothing)
        loss = loss + own.refined.steady * _change(network, first, drawn, like_first)
        for group in optimizer.param_groups:
            group["lr"] = learning_rate_at(step, own.steps, own.learning_rate)
        optimizer.zero_grad()
        loss.backward()  # type: ignore[no-untyped-call]
        torch.nn.utils.clip_grad_norm_(learning, GRADIENT_LIMIT)
        optimizer.step()
        follow = 1.0 - min(own.average_decay, (step + 1) / (step + 10))
        for mean, weight in zip(average, learning, strict=True):
            mean.lerp_(weight.detach(), follow)
        progress.set_postfix(loss=f"{float(loss.detach()):.3f}", refresh=False)
    for mean, weight in zip(average, learning, strict=True):
        weight.data.copy_(mean)
    return {key: value.detach().clone() for key, value in network.state_dict().items()}


def kept(learnt: Sequence[dict[str, Tensor]], begun: TGC, share: float, known: int) -> dict[str, Tensor]:
    """Return the mean of the trained weights, blended with the initial ones except in the rows of new labels.

    share: of the initial weights. known: the number of labels that are not new; they come first.
    """
    first = begun.state_dict()
    last = f"dense.{len(begun.dense) - 1}."
    blended = {}
    for name in first:
        weights = torch.stack([each[name] for each in learnt]).mean(dim=0)
        blended[name] = torch.lerp(weights, first[name], share)
        if name.startswith(last):
            blended[name][known:] = weights[known:]
    return blended


def _loss(network: TGC, batch: Drawn, smoothing: float) -> Tensor:
    logits = network.answers(network.encoder(batch.frames), batch.lengths)
    logits = logits.masked_fill(~batch.possible[:, None], IMPOSSIBLE)
    even = (batch.possible / batch.possible.sum(dim=-1, keepdim=True))[:, None]
    expected = torch.lerp(batch.targets, even.expand_as(batch.targets), smoothing)
    losses = -(expected * functional.log_softmax(logits, dim=-1)).sum(dim=-1)
    return (losses * batch.weights).mean()


def _change(network: TGC, first: TGC, drawn: Drawn, places: Tensor) -> Tensor:
    """Return the divergence of the network's answers about known gestures from the first network's, in nats.

    It is measured on mixtures of two windows. On the windows themselves, the two soon agree, yet they differ
    on other people ("a good teacher is patient and consistent", Beyer et al., CVPR 2022).
    """
    one, other = (drawn.of(places[torch.randint(len(places), (MIXED,))]) for _ in range(2))
    frames = torch.lerp(one.frames, other.frames, torch.rand(MIXED, 1, 1))
    with torch.no_grad():
        wanted = torch.softmax(first.answers(first.encoder(frames), one.lengths)[..., :-1], dim=-1)
    answered = functional.log_softmax(network.answers(network.encoder(frames), one.lengths)[..., :-1], dim=-1)
    changes = functional.kl_div(answered, wanted, reduction="none").sum(dim=-1)
    return (changes * one.weights).mean()


def as_other(recordings: Sequence[Recording]) -> list[Recording]:
    """Return the recordings labelled as `other`."""
    return [replace(recording, gesture=OTHER) for recording in recordings]
