"""Fine-tunes the head of a pretrained network on a few recordings, regularised towards its initial weights.

L2-SP (Li, Grandvalet and Davoine 2018) is a Gaussian prior on every weight around its pretrained value. Its
weight grows with fewer recordings. The result interpolates between pretrained and fine-tuned weights
(Wortsman et al. 2022): the person keeps most of the gain, and other people lose less. Part of each batch is
rehearsal of other people. All three were chosen on the second study; see docs/adapt.md.
"""

import copy
from collections.abc import Sequence
from typing import cast

import msgspec
import torch
from torch import Tensor, nn
from torch.nn import functional

from touchd.model.adapt.backbone import CropFeatures
from touchd.model.adapt.optimise import GRADIENT_LIMIT, learning_rate_at


class AdaptSettings(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Settings of fine-tuning.

    crops: per recording, augmented as in training. l2_sp: weight of the squared distance from the pretrained
    head, divided by the number of recordings; rows of new gestures are not penalised. rehearsed: share of
    rehearsal in each batch. blend: interpolation from pretrained (0) to fine-tuned weights (1); rows of new
    gestures are always 1.
    """

    seed: int = 0
    crops: int = 16
    steps: int = 200
    batch: int = 32
    learning_rate: float = 3e-3
    label_smoothing: float = 0.05
    l2_sp: float = 0.02
    rehearsed: float = 0.35
    blend: float = 0.8


def rebuilt(head: nn.Sequential, known: Sequence[str], labels: Sequence[str]) -> nn.Sequential:
    """Return the head with one row per label; rows of new labels start as the mean of the known rows."""
    new = copy.deepcopy(head)
    last = cast(nn.Linear, new[-1])
    rows = [known.index(label) if label in known else None for label in labels]

    def chosen(values: Tensor) -> nn.Parameter:
        mean = values.detach().mean(dim=0)
        return nn.Parameter(torch.stack([mean if row is None else values.detach()[row] for row in rows]))

    last.weight, last.bias, last.out_features = chosen(last.weight), chosen(last.bias), len(labels)
    return new


def fit(
    start: nn.Sequential,
    labels: Sequence[str],
    new: Sequence[str],
    shown: CropFeatures,
    rehearsed: CropFeatures,
    settings: AdaptSettings,
) -> nn.Sequential:
    """Return a copy of `start` fine-tuned on `shown`.

    labels: one per row of the head, each in `shown` or `rehearsed`. new: those the shipped network lacks.
    rehearsed: features of other people. Deterministic.
    """
    head = copy.deepcopy(start).train()
    is_new = torch.tensor([label in new for label in labels])
    before = [weight.detach().clone() for weight in start.parameters()]
    penalties = _each(start, settings.l2_sp, 0.0, is_new)
    rng = torch.Generator().manual_seed(settings.seed)
    optimizer = torch.optim.AdamW(head.parameters(), weight_decay=0.0)
    from_rehearsed = int(settings.batch * settings.rehearsed)
    counts = settings.batch - from_rehearsed, from_rehearsed
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(settings.seed)
        for step in range(settings.steps):
            sources = zip((shown, rehearsed), counts, strict=True)
            parts = [_draw(crops, labels, count, rng) for crops, count in sources]
            distance = sum(
                (penalty * (weight - pretrained).square()).sum()
                for penalty, weight, pretrained in zip(penalties, head.parameters(), before, strict=True)
            )
            loss = _loss(head, parts, settings) + distance / len(shown.gestures)
            _descend(loss, optimizer, learning_rate_at(step, settings.steps, settings.learning_rate))
    head.eval().requires_grad_(False)
    shares = _each(start, settings.blend, 1.0, is_new)
    for weight, pretrained, part in zip(head.parameters(), before, shares, strict=True):
        weight.copy_(torch.lerp(pretrained, weight, part))
    return head


def _descend(loss: Tensor, optimizer: torch.optim.Optimizer, learning_rate: float) -> None:
    (group,) = optimizer.param_groups
    group["lr"] = learning_rate
    optimizer.zero_grad()
    loss.backward()  # type: ignore[no-untyped-call]
    torch.nn.utils.clip_grad_norm_(group["params"], GRADIENT_LIMIT)
    optimizer.step()


def _loss(head: nn.Sequential, parts: Sequence[tuple[Tensor, ...]], settings: AdaptSettings) -> Tensor:
    """Return the mean cross entropy of drawn crops at the lengths that their recordings have."""
    values, targets, within = (torch.cat(part) for part in zip(*parts, strict=True))
    losses = functional.cross_entropy(
        head(values).flatten(0, 1),
        targets.repeat_interleave(values.shape[1]),
        label_smoothing=settings.label_smoothing,
        reduction="none",
    )
    return losses[within.flatten()].mean()


def _each(head: nn.Sequential, value: float, of_new: float, is_new: Tensor) -> list[Tensor]:
    """Return `value` for each of a head's parameters, `of_new` for the last layer's rows of new labels."""
    *lower, weight, _bias = head.parameters()
    rows = torch.where(is_new, of_new, value)
    return [*(torch.full_like(each, value) for each in lower), rows[:, None].expand_as(weight), rows]


def _draw(
    crops: CropFeatures, labels: Sequence[str], count: int, rng: torch.Generator
) -> tuple[Tensor, Tensor, Tensor]:
    """Draw random crops; return values (count, 4, features), classes (count,) and within (count, 4)."""
    recordings = len(crops.gestures)
    # Draw each recording equally often.
    passes = [torch.randperm(recordings, generator=rng) for _ in range(-(-count // recordings))]
    chosen = torch.cat(passes)[:count]
    crop = torch.randint(crops.values.shape[1], (count,), generator=rng)
    classes = torch.tensor([labels.index(crops.gestures[i]) for i in chosen.tolist()])
    return crops.values[chosen, crop], classes, crops.within[chosen]
