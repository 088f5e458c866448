"""Adapting: the head of a trained network learns from a few recordings, and is held to where it came from.

The pull back to the start is a Gaussian prior on every weight (L2-SP, Li, Grandvalet and Davoine 2018). The
fewer the recordings, the more it counts: they are evidence against a start that has seen hundreds. Which
layers, which pull and how long was chosen on HAART's training participants left out; see docs/adapt.md.
"""

from __future__ import annotations

import copy
from collections.abc import Sequence
from typing import cast

import msgspec
import torch
from torch import Tensor, nn
from torch.nn import functional

from model.adapt.backbone import Crops
from model.training.train import GRADIENT_LIMIT, learning_rate_at


class AdaptSettings(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Everything that decides what adapting yields, apart from the recordings and where it starts from.

    crops: of each recording, varied as in training. pull: weight of the squared distance from the start,
    shared out over the recordings; what answers for a gesture that the start did not know is not pulled.
    rehearsed: share of each batch that shows HAART, where that is at hand; rehearsal_pull: the pull then.
    """

    seed: int = 0
    crops: int = 6
    steps: int = 100
    batch: int = 32
    learning_rate: float = 3e-3
    label_smoothing: float = 0.05
    pull: float = 7.0
    rehearsed: float = 0.5
    rehearsal_pull: float = 0.5


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
    shown: Crops,
    rehearsed: Crops | None,
    settings: AdaptSettings,
) -> nn.Sequential:
    """Return a head that has learnt what is `shown`, from `start`, which stays as it is.

    labels: of the head's rows. new: those that the shipped network did not know. rehearsed: what shall not be
    forgotten. The same arguments give the same head.

    A label that is never shown is left out of the comparison: that it is absent is no evidence against it.
    """
    present = {*shown.gestures, *(rehearsed.gestures if rehearsed is not None else ())}
    compared = [label for label in labels if label in present]
    columns = torch.tensor([labels.index(label) for label in compared])
    head = copy.deepcopy(start).train()
    held = _Start(start, [label in new for label in labels], settings, rehearsed is not None)
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
            loss = losses[within.flatten()].mean() + held.distance(head) / len(shown.gestures)
            for group in optimizer.param_groups:
                group["lr"] = learning_rate_at(step, settings.steps, settings.learning_rate)
            optimizer.zero_grad()
            loss.backward()  # type: ignore[no-untyped-call]
            torch.nn.utils.clip_grad_norm_(head.parameters(), GRADIENT_LIMIT)
            optimizer.step()
    return head.eval().requires_grad_(False)


class _Start:
    """Where a head began, and how strongly each of its weights is pulled back there."""

    def __init__(
        self, head: nn.Sequential, is_new: Sequence[bool], settings: AdaptSettings, rehearses: bool
    ) -> None:
        self._weights = [weight.detach().clone() for weight in head.parameters()]
        pull = settings.rehearsal_pull if rehearses else settings.pull
        rows = torch.tensor([0.0 if new else pull for new in is_new])
        last = cast(nn.Linear, head[-1])
        self._pulls = [torch.tensor(pull) for _ in self._weights]
        # The last layer's weight and bias are the last two.
        assert self._weights[-1].shape == last.bias.shape
        self._pulls[-2:] = [rows[:, None], rows]

    def distance(self, head: nn.Sequential) -> Tensor:
        """Return the squared distance of a head from the start, weighted by the pulls."""
        apart = [
            (pull * (weight - before).square()).sum()
            for pull, weight, before in zip(self._pulls, head.parameters(), self._weights, strict=True)
        ]
        return torch.stack(apart).sum()


def _draw(
    crops: Crops, labels: Sequence[str], count: int, rng: torch.Generator
) -> tuple[Tensor, Tensor, Tensor]:
    """Return values (count, 4, features), classes (count,) and within (count, 4) of crops drawn at random."""
    recordings = len(crops.gestures)
    # As even a draw as there are recordings for.
    passes = [torch.randperm(recordings, generator=rng) for _ in range(-(-count // recordings))]
    chosen = torch.cat(passes)[:count]
    crop = torch.randint(crops.values.shape[1], (count,), generator=rng)
    classes = torch.tensor([labels.index(crops.gestures[i]) for i in chosen.tolist()])
    return crops.values[chosen, crop], classes, crops.within[chosen]
