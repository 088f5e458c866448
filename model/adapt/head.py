"""Fine-tunes the head of a pretrained network on a few recordings, regularised towards its initial weights.

L2-SP (Li, Grandvalet and Davoine 2018) is a Gaussian prior on every weight around its pretrained value. Its
weight grows with fewer recordings. The result interpolates between pretrained and fine-tuned weights
(Wortsman et al. 2022): the person keeps most of the gain, and other people lose less. Part of each batch is
rehearsal of other people. All three were chosen on the second study; see docs/adapt.md.
"""

import copy
import math
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import cast

import msgspec
import torch
from torch import Tensor, nn
from torch.nn import functional
from torch.nn.utils import clip_grad_norm_, parameters_to_vector, vector_to_parameters

from touchd.model.adapt.backbone import CropFeatures

# The class at lengths that a recording does not reach; ignored in the loss.
UNASKED = -1
GRADIENT_LIMIT = 1.0


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
    rows = [known.index(label) if label in known else len(known) for label in labels]

    def chosen(values: Tensor) -> nn.Parameter:
        return nn.Parameter(torch.cat([values, values.mean(dim=0, keepdim=True)]).detach()[rows])

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
    before = parameters_to_vector(start.parameters()).detach()
    known = _known(start, [label in new for label in labels])
    rng = torch.Generator().manual_seed(settings.seed)
    optimizer = torch.optim.AdamW(head.parameters(), weight_decay=0.0)
    from_rehearsed = int(settings.batch * settings.rehearsed)
    sources = ((shown, settings.batch - from_rehearsed), (rehearsed, from_rehearsed))
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(settings.seed)
        for step in range(settings.steps):
            optimizer.param_groups[0]["lr"] = learning_rate_at(step, settings.steps, settings.learning_rate)
            parts = [_draw(crops, labels, count, rng) for crops, count in sources]
            distance = (known * (parameters_to_vector(head.parameters()) - before).square()).sum()
            loss = _loss(head, parts, settings) + settings.l2_sp * distance / len(shown.gestures)
            optimizer.zero_grad()
            loss.backward()  # type: ignore[no-untyped-call]
            clip_grad_norm_(head.parameters(), GRADIENT_LIMIT)
            optimizer.step()
    head.eval().requires_grad_(False)
    after = parameters_to_vector(head.parameters())
    blended = torch.lerp(before, after, 1.0 - (1.0 - settings.blend) * known)
    vector_to_parameters(blended, head.parameters())
    return head


def learning_rate_at(step: int, steps: int, peak: float) -> float:
    """One-cycle schedule: linear warm-up over the first tenth, then cosine decay to zero (Smith 2018)."""
    rise = max(1, steps // 10)
    if step < rise:
        return peak * (step + 1) / rise
    return 0.5 * peak * (1.0 + math.cos(math.pi * (step - rise) / max(1, steps - rise)))


def _loss(head: nn.Sequential, parts: Sequence[tuple[Tensor, ...]], settings: AdaptSettings) -> Tensor:
    """Return the mean cross entropy of drawn crops at the lengths that their recordings have."""
    values, classes = (torch.cat(part).flatten(0, 1) for part in zip(*parts, strict=True))
    smoothing = settings.label_smoothing
    return functional.cross_entropy(head(values), classes, ignore_index=UNASKED, label_smoothing=smoothing)


def _known(head: nn.Sequential, is_new: list[bool]) -> Tensor:
    """Return 1 for each of a head's weights, 0 for those of new gestures' rows in its last layer."""
    masks = list(map(torch.ones_like, head.parameters()))
    for last in masks[-2:]:
        last[is_new] = 0.0
    return parameters_to_vector(masks)


def _draw(
    crops: CropFeatures, labels: Sequence[str], count: int, rng: torch.Generator
) -> tuple[Tensor, Tensor]:
    """Draw random crops; return values (count, 4, features), and classes (count, 4) or UNASKED."""
    recordings = len(crops.gestures)
    # Draw each recording equally often.
    passes = [torch.randperm(recordings, generator=rng) for _ in range(-(-count // recordings))]
    chosen = torch.cat(passes)[:count]
    crop = torch.randint(crops.values.shape[1], (count,), generator=rng)
    classes = torch.tensor([[labels.index(crops.gestures[i])] for i in chosen.tolist()])
    return crops.values[chosen, crop], torch.where(crops.within[chosen], classes, UNASKED)


@contextmanager
def one_torch_thread() -> Iterator[None]:
    """Make PyTorch compute on one thread inside this context."""
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        yield
    finally:
        torch.set_num_threads(before)
