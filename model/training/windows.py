"""Draws the windows of a training from its own people's recordings, and varies and mixes them."""

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor, nn
from torch.nn import functional

from touchd.drivers.frame import NO_TOUCH
from touchd.drivers.recording import Recording
from touchd.model.adapt.augment import Frames, begin_from_rest, crop, vary
from touchd.model.training.other_pads import as_another_pad, as_quiet_pad
from touchd.model.training.passing import Passing
from touchd.model.training.settings import TrainSettings
from touchd.model.training.studies import MISSING, study_of


@dataclass(frozen=True, eq=False)
class Batch:
    """The data of one training step, for N networks.

    windows: (N, B, T, 8, 8) counts. targets: (N, B, classes). possible: (N, B, classes) bool, the answers
    that the loss compares. lengths: (N, B, K) frames after which each window is answered. weights: the same
    shape, of each answer in the loss.
    """

    windows: Tensor
    targets: Tensor
    possible: Tensor
    lengths: Tensor
    weights: Tensor


class WindowSampler:
    """Draws batches for networks that train in parallel. settings: of each network."""

    def __init__(
        self, recordings: Sequence[Recording], settings: Sequence[TrainSettings], device: str
    ) -> None:
        self.recordings = recordings
        self.each = tuple(settings)
        self.settings = settings[0]
        self.labels = tuple(sorted({recording.gesture for recording in recordings}))
        self.frames = Frames.of(
            [torch.from_numpy(recording.counts.astype(np.float32)) for recording in recordings], device
        )
        self.classes = torch.tensor(
            [self.labels.index(recording.gesture) for recording in recordings], device=device
        )
        self.missing = torch.tensor([label in MISSING["third"] for label in self.labels], device=device)
        soft = [study_of(recording.participant) == "third" for recording in recordings]
        self.soft = torch.tensor(soft, device=device)
        self.drawn = torch.stack([self._drawn(own) for own in settings]).to(device)
        self.rests, self.rest_counts = (table.to(device) for table in self._rests())
        self.passing = Passing.of(recordings, self.soft.tolist(), device) if self.settings.passing else None
        self.lengths = torch.tensor(self.settings.lengths, device=device)
        # The generator of dropout too: the device's own.
        self.rng = torch.cuda.default_generators[0] if device == "cuda" else torch.default_generator

    def draw(self) -> Batch:
        """Return a batch of windows for every network."""
        settings, varied, rng = self.settings, self.settings.augmentation, self.rng
        N, B = len(self.each), settings.batch
        places = torch.rand(N, B, generator=rng, device=rng.device)
        chosen = torch.searchsorted(self.drawn, places, right=True).flatten()
        windows = crop(self.frames, chosen, settings.window, varied, rng)
        counts = self.rest_counts[chosen]
        rest = (torch.rand(N * B, generator=rng, device=rng.device) * counts).long()
        still = crop(self.frames, self.rests[chosen, rest], settings.window, varied, rng)
        risen = begin_from_rest(windows, still, varied, rng)
        windows = torch.where((counts > 0)[:, None, None, None], risen, windows)
        lengths = self.lengths.expand(N * B, -1)
        weights = torch.ones_like(lengths, dtype=torch.float32)
        if self.passing is not None:
            share = settings.passing
            windows, lengths, weights = self.passing.some(self.frames, chosen, windows, lengths, share, rng)
        soft = self.soft[chosen]
        fabric = as_quiet_pad(as_another_pad(windows, varied, rng), varied, rng)
        windows = torch.where(soft[:, None, None, None], windows, fabric)
        windows = vary(windows, varied, rng).reshape(N, B, *windows.shape[1:])
        targets = functional.one_hot(self.classes[chosen], len(self.labels)).float().reshape(N, B, -1)
        windows, targets, soft = self._mix(windows, targets, soft.reshape(N, B))
        lengths, weights = (each.reshape(N, B, -1) for each in (lengths, weights))
        return Batch(windows, targets, self.possible(targets, soft), lengths, weights)

    def _drawn(self, own: TrainSettings) -> Tensor:
        """Return (R,), the cumulative probability with which a network draws windows from each recording."""
        shares = shares_of(self.recordings, own)
        until = (shares.cumsum(0) / shares.sum()).float()
        # Nothing is drawn after the last recording, whatever the rounding.
        return torch.where(until >= until[-1], 2.0, until)

    def _rests(self) -> tuple[Tensor, Tensor]:
        """Return (R, most), (R,): of each recording, its participant's recordings at rest; their number."""
        resting: dict[str, list[int]] = {recording.participant: [] for recording in self.recordings}
        for i, recording in enumerate(self.recordings):
            if recording.gesture == NO_TOUCH:
                resting[recording.participant].append(i)
        own = [torch.tensor(resting[each.participant], dtype=torch.long) for each in self.recordings]
        padded = nn.utils.rnn.pad_sequence(own, batch_first=True)
        return functional.pad(padded, (0, 1)), torch.tensor([len(each) for each in own])

    def _mix(self, windows: Tensor, targets: Tensor, soft: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """Blend some windows (N, B, T, 8, 8) with others, on the scale that the network sees.

        soft: (N, B) bool, whether a window is of the third study's pad.
        """
        share, chance, order = torch.rand(3, *soft.shape, generator=self.rng, device=self.rng.device)
        share = 0.5 * share * (chance < self.settings.augmentation.mix)
        other = order.argsort(dim=1)
        stack = torch.arange(len(windows), device=windows.device)[:, None]
        knee = self.settings.network.knee_counts
        levels = torch.log(windows + knee)
        mixed = torch.exp(torch.lerp(levels, levels[stack, other], share[:, :, None, None, None])) - knee
        blended = torch.lerp(targets, targets[stack, other], share[:, :, None])
        return mixed, blended, soft | (soft[stack, other] & (share > 0))

    def possible(self, targets: Tensor, soft: Tensor) -> Tensor:
        """Return (N, B, classes) bool, the answers that the loss compares: the third study has no tickle.

        Otherwise, the network would learn that "tickle" means the other studies' pad.
        """
        possible: Tensor = ~(soft[..., None] & self.missing) | (targets > 0)
        return possible


def shares_of(recordings: Sequence[Recording], own: TrainSettings) -> Tensor:
    """Return (R,), the relative frequency with which a network draws windows from each recording."""
    recorded = Counter(each.participant for each in recordings if learns(own, each))
    people = Counter(study_of(participant) for participant in recorded)

    def share(recording: Recording) -> float:
        if not learns(own, recording):
            return 0.0
        if own.shares is None:
            return 1.0
        study = study_of(recording.participant)
        of_study: float = getattr(own.shares, study)
        return of_study / people[study] / recorded[recording.participant]

    return torch.tensor([share(each) for each in recordings], dtype=torch.float64)


def learns(own: TrainSettings, recording: Recording) -> bool:
    """Whether a network learns from a recording."""
    return recording.participant not in own.left_out and study_of(recording.participant) in own.studies
