"""Fine-tunes the head of a pretrained network on a few recordings, regularised towards where it began.

L2-SP (Li, Grandvalet and Davoine 2018) is a Gaussian prior on every weight around its pretrained value. The
fewer the recordings, the more it counts. Layers, weight of the penalty and number of steps were chosen on
HAART's training participants left out; see docs/adapt.md.
"""

from __future__ import annotations

import copy
from collections.abc import Sequence
from typing import cast

import msgspec
import torch
from torch import Tensor, nn
from torch.nn import functional

from model.adapt.backbone import CropFeatures
from model.training.schedule import GRADIENT_LIMIT, learning_rate_at


class AdaptSettings(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Everything that decides what adapting yields, apart from the recordings and where it starts from.

    crops: per recording, augmented as in training. l2_sp: weight of the squared distance from the pretrained
    head, divided by the number of recordings; rows of new gestures are free. rehearsed: share of each batch
    that shows HAART, if given; rehearsal_l2_sp: the weight then.
    """

    seed: int = 0
    crops: int = 6
    steps: int = 100
    batch: int = 32
    learning_rate: float = 3e-3
    label_smoothing: float = 0.05
    l2_sp: float = msgspec.field(default=7.0, name="pull")
    rehearsed: float = 0.5
    rehearsal_l2_sp: float = msgspec.field(default=0.5, name="rehearsal_pull")


def rebuilt(head: nn.Sequential, known: Sequence[str], labels: Sequence[str]) -> nn.Sequential:
    """Return the head with one row a label: known labels keep theirs, new ones begin as the rows' mean."""
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
    rehearsed: CropFeatures | None,
    settings: AdaptSettings,
) -> nn.Sequential:
    """Return a head that has learnt what is `shown`, from `start`, which stays as it is.

    labels: of the head's rows. new: those that the shipped network did not know. rehearsed: what must not be
    forgotten. The same arguments give the same head.

    A label that is never shown is left out of the comparison: that it is absent is no evidence against it.
    """
    present = {*shown.gestures, *(rehearsed.gestures if rehearsed is not None else ())}
    compared = [label for label in labels if label in present]
    columns = torch.tensor([labels.index(label) for label in compared])
    head = copy.deepcopy(start).train()
    penalty = _L2SP(start, [label in new for label in labels], settings, rehearsed is not None)
    rng = torch.Generator().manual_seed(settings.seed)
    optimizer = torch.optim.AdamW(head.parameters(), weight_decay=0.0)
    share = settings.rehearsed if rehearsed is not None else 0.0
    from_rehearsed = int(settings.batch * share)
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(settings.seed)
        for step in range(settings.steps):
            parts = [_draw(shown, compared, settings.batch - from_rehearsed, rng)]
            if rehearsed is not None:
                parts.append(_draw(rehearsed, compared, from_rehearsed, rng))
            values, targets, within = (torch.cat(part) for part in zip(*parts, strict=True))
            losses = functional.cross_entropy(
                head(values)[..., columns].flatten(0, 1),
                targets.repeat_interleave(values.shape[1]),
                label_smoothing=settings.label_smoothing,
                reduction="none",
            )
            loss = losses[within.flatten()].mean() + penalty.distance(head) / len(shown.gestures)
            for group in optimizer.param_groups:
                group["lr"] = learning_rate_at(step, settings.steps, settings.learning_rate)
            optimizer.zero_grad()
            loss.backward()  # type: ignore[no-untyped-call]
            torch.nn.utils.clip_grad_norm_(head.parameters(), GRADIENT_LIMIT)
            optimizer.step()
    return head.eval().requires_grad_(False)


class _L2SP:
    """The weights that a head began with, and how strongly each is held there."""

    def __init__(
        self, head: nn.Sequential, is_new: Sequence[bool], settings: AdaptSettings, rehearses: bool
    ) -> None:
        self._weights = [weight.detach().clone() for weight in head.parameters()]
        weight = settings.rehearsal_l2_sp if rehearses else settings.l2_sp
        rows = torch.tensor([0.0 if new else weight for new in is_new])
        last = cast(nn.Linear, head[-1])
        self._penalties = [torch.tensor(weight) for _ in self._weights]
        # The last layer's weight and bias are the last two.
        assert self._weights[-1].shape == last.bias.shape
        self._penalties[-2:] = [rows[:, None], rows]

    def distance(self, head: nn.Sequential) -> Tensor:
        """Return the squared distance of a head from the pretrained one, weighted."""
        apart = [
            (penalty * (weight - before).square()).sum()
            for penalty, weight, before in zip(self._penalties, head.parameters(), self._weights, strict=True)
        ]
        return torch.stack(apart).sum()


def _draw(
    crops: CropFeatures, labels: Sequence[str], count: int, rng: torch.Generator
) -> tuple[Tensor, Tensor, Tensor]:
    """Return values (count, 4, features), classes (count,) and within (count, 4) of crops drawn at random."""
    recordings = len(crops.gestures)
    # As even a draw as there are recordings for.
    passes = [torch.randperm(recordings, generator=rng) for _ in range(-(-count // recordings))]
    chosen = torch.cat(passes)[:count]
    crop = torch.randint(crops.values.shape[1], (count,), generator=rng)
    classes = torch.tensor([labels.index(crops.gestures[i]) for i in chosen.tolist()])
    return crops.values[chosen, crop], classes, crops.within[chosen]
