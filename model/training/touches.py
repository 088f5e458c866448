"""Draws the windows to refine a network on: gestures, slow caresses, hands that change, unknown touches.

An unknown touch is none of the gestures. Known and unknown touches come from every kind of pad, with the
same augmentation, so that the pad does not predict the answer: fabric is also softened and pooled, the third
study's pad also sharpened and scaled to fabric's range.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import msgspec
import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor
from torch.nn import functional

from touchd.drivers.frame import MAX_COUNT, NO_TOUCH, OTHER
from touchd.drivers.recording import Recording
from touchd.model.adapt.augment import Frames, begin_from_rest, crop, vary
from touchd.model.training import caress, unknown
from touchd.model.training.other_pads import as_another_pad, as_quiet_pad
from touchd.model.training.passing import FORGOTTEN_FRAMES, Passing
from touchd.model.training.settings import Refinement, TrainSettings
from touchd.model.training.studies import MISSING, study_of
from touchd.model.training.windows import learns, shares_of

# For this many frames after a change, answers have no weight in the loss: neither gesture is right.
TURNING_FRAMES = 24
EARLIEST_CHANGE, LATEST_CHANGE = 20, 100
FADE_FRAMES = 6
# Weight in the loss of answers to the first frames of an unknown touch.
SOON_FRAMES, SHORT_WEIGHT = 18, 0.3
# Rest before a touch: the tracker dates its beginning a few frames too early.
MOST_LEAD_FRAMES = 4

Window = tuple[NDArray[np.floating[Any]], int]
"""Counts (T, 8, 8), and the frame after the last one that is touched."""


@dataclass(frozen=True, eq=False)
class Touches:
    """Drawn windows.

    counts: (B, T, 8, 8). lengths, weights: (B, K). targets: (B, K, classes). possible: (B, classes).
    taught: (B,), the weight of the initial network's answers in the targets. unknown: (B,), the share of an
    unknown touch.
    """

    counts: Tensor
    lengths: Tensor
    weights: Tensor
    targets: Tensor
    possible: Tensor
    taught: Tensor
    unknown: Tensor


class TouchSampler:
    """Draws windows for one network. recordings: known gestures, then those of the label `other`."""

    def __init__(self, recordings: Sequence[Recording], labels: Sequence[str], own: TrainSettings) -> None:
        assert own.refined is not None
        self.recordings, self.labels, self.own = recordings, tuple(labels), own
        self.refined: Refinement = own.refined
        self.frames = Frames.of([torch.from_numpy(each.counts.astype(np.float32)) for each in recordings])
        self.classes = torch.tensor([self.labels.index(each.gesture) for each in recordings])
        is_soft = [study_of(each.participant) == "third" for each in recordings]
        self.soft = torch.tensor(is_soft)
        self.missing = torch.tensor([label in MISSING["third"] for label in self.labels])
        self.passing = Passing.of(recordings, is_soft, "cpu")
        known = [each for each in recordings if each.gesture != OTHER]
        others = [each for each in recordings if each.gesture == OTHER]
        self._known = torch.cat([shares_of(known, own), torch.zeros(len(others), dtype=torch.float64)])
        self._other = torch.cat([torch.zeros(len(known), dtype=torch.float64), shares_of(others, own)])
        is_stroke = torch.tensor([each.gesture == "stroke" for each in recordings])
        self._strokes = torch.where(is_stroke & (self.passing.contacts > 0), self._known, 0.0)
        at_rest = [each.gesture == NO_TOUCH and learns(own, each) and study_of(each.participant) != "third"
                   for each in recordings]  # fmt: skip
        self._fabric_rests = torch.tensor([i for i, is_rest in enumerate(at_rest) if is_rest])
        self.rng = torch.default_generator
        self.made = np.random.default_rng(own.seed)

    def draw(self, B: int) -> Touches:
        """Return a batch of windows."""
        own, varied, T = self.refined, self.own.augmentation, self.own.window
        chosen = torch.multinomial(self._known, B, replacement=True)
        chance = torch.rand(B)
        is_unknown = chance < own.unknown
        is_slow = ~is_unknown & (chance < own.unknown + own.slow)
        chosen = torch.where(is_slow, torch.multinomial(self._strokes, B, replacement=True), chosen)
        is_real = is_unknown & self.soft[chosen] & (torch.rand(B) < own.real)
        if self._other.sum() > 0:
            chosen = torch.where(is_real, torch.multinomial(self._other, B, replacement=True), chosen)
        targets = functional.one_hot(self.classes[chosen], len(self.labels)).float()
        still = self._still(chosen, T)
        windows = crop(self.frames, chosen, T, varied, self.rng)
        windows = torch.where(
            self.passing.touches[chosen][:, None, None, None],
            begin_from_rest(windows, still, varied, self.rng),
            windows,
        )
        usual = torch.tensor(self.own.lengths).expand(B, -1)
        windows, lengths, weights = self.passing.some(
            self.frames, chosen, windows, usual, self.own.passing, self.rng
        )
        targets = targets[:, None].repeat(1, lengths.shape[1], 1)
        taught = torch.full((B,), own.taught)
        batch = Touches(
            windows, lengths, weights, targets, torch.ones(B, len(self.labels)), taught, is_real.float()
        )
        for place in torch.nonzero(is_unknown & ~is_real).flatten().tolist():
            self._make_unknown(batch, place, int(chosen[place]), still[place])
        for place in torch.nonzero(is_slow).flatten().tolist():
            self._make_slow(batch, place, int(chosen[place]), still[place])
        # The first frames hardly show what the touch will be.
        is_short = (batch.lengths < SOON_FRAMES) & is_unknown[:, None]
        batch.weights[is_short] *= SHORT_WEIGHT
        self._vary_hands(batch, ~is_unknown & ~is_slow & self.passing.touches[chosen], chosen, still)
        soft = self.soft[chosen]
        made_soft = soft & is_unknown & ~is_real
        counts = self._on_pads(batch.counts, soft, made_soft)
        # Slow caresses made on fabric teach less if they are then read as another pad.
        counts = torch.where((is_slow & ~soft)[:, None, None, None], batch.counts, counts)
        return self._mix(replace(batch, counts=vary(counts, varied, self.rng)), soft)

    def _vary_hands(self, batch: Touches, plain: Tensor, chosen: Tensor, still: Tensor) -> None:
        """Change the gesture of some plain touches (B,) bool, and add a second hand to others."""
        own = self.refined
        share = 1.0 - own.unknown - own.slow
        for place in torch.nonzero(plain).flatten().tolist():
            chance = float(self.made.random())
            if chance < own.changed / share:
                self._change(batch, place, int(chosen[place]))
            elif chance < (own.changed + own.both) / share:
                self._add_hand(batch, place, int(chosen[place]), still[place])

    def _still(self, chosen: Tensor, T: int) -> Tensor:
        """Return (B, T, 8, 8) of the pads at rest."""
        rests, counts = self.passing.rests[chosen], self.passing.rest_counts[chosen]
        resting = rests.gather(1, (torch.rand(len(chosen)) * counts).long()[:, None])[:, 0]
        as_it_is = msgspec.structs.replace(self.own.augmentation, published_framing=0.0, change_pace=0.0)
        return crop(self.frames, resting, T, as_it_is, self.rng)

    def _lay(self, batch: Touches, place: int, window: Window) -> None:
        """Put a window into the batch; answers long after the touch have no weight in the loss."""
        counts, over = window
        batch.counts[place] = torch.from_numpy(counts.astype(np.float32))
        T = len(counts)
        if over < T:
            batch.lengths[place, -1] = min(T, over + int(self.made.integers(9, 20)))
        forgotten = batch.lengths[place] > over + FORGOTTEN_FRAMES
        weights = (~forgotten).float()
        batch.weights[place] = weights / weights.mean()

    def _make_unknown(self, batch: Touches, place: int, recording: int, still: Tensor) -> None:
        T = self.own.window
        lead = int(self.made.integers(MOST_LEAD_FRAMES))
        if self.made.random() < self.refined.shuffled and self.labels[self.classes[recording]] not in (
            NO_TOUCH,
            "constant",
        ):
            whole = batch.counts[place].numpy()
            self._lay(batch, place, (unknown.shuffled(self.made, whole), T))
        else:
            touch = unknown.make(self.made, T - lead)
            if bool(self.soft[recording]):
                touch *= np.exp(self.made.uniform(-1.6, -0.3))
            window = still.numpy().astype(np.float64)
            window[lead:] += touch
            self._lay(batch, place, (window, lead + unknown.last_frame(touch)))
        batch.targets[place] = functional.one_hot(
            torch.tensor(self.labels.index(OTHER)), len(self.labels)
        ).float()
        batch.unknown[place] = 1.0

    def _make_slow(self, batch: Touches, place: int, recording: int, still: Tensor) -> None:
        T, rest = self.own.window, still.numpy().astype(np.float64)
        lead = int(self.made.integers(MOST_LEAD_FRAMES))
        if self.made.random() < 0.5:
            stroke = caress.made(self.made)
            if bool(self.soft[recording]):
                stroke *= np.exp(self.made.uniform(-1.0, 0.3))
            is_added = True
        else:
            contact = int(self.made.integers(int(self.passing.contacts[recording])))
            start, stop = (
                int(table[recording, contact]) for table in (self.passing.starts, self.passing.stops)
            )
            stroke = caress.slowed(
                self.made, self.recordings[recording].counts[start:stop].astype(np.float64)
            )
            is_added = False
        begin = 0
        if len(stroke) > T and self.made.random() < 0.6:
            begin = int(self.made.integers(len(stroke) - T + 1))
            begin, lead = (len(stroke) - T if self.made.random() < 0.3 else begin), 0
        shown = stroke[begin : begin + T - lead]
        laid = rest.copy()
        laid[lead : lead + len(shown)] = rest[lead : lead + len(shown)] + shown if is_added else shown
        self._lay(batch, place, (laid, min(T, lead + len(shown))))
        batch.taught[place] = 0.0

    def _partner(self, recording: int) -> int | None:
        """Return a recording of another gesture by the same person on the same pad."""
        own = self.recordings[recording]
        found = [
            i
            for i, each in enumerate(self.recordings)
            if each.participant == own.participant
            and each.substrate == own.substrate
            and each.cover == own.cover
            and each.gesture not in (own.gesture, NO_TOUCH, OTHER)
        ]
        return int(self.made.choice(found)) if found else None

    def _piece(self, recording: int) -> NDArray[np.float64]:
        T, counts = self.own.window, self.recordings[recording].counts
        start = int(self.made.integers(len(counts) - T + 1))
        return counts[start : start + T].astype(np.float64)

    def _change(self, batch: Touches, place: int, recording: int) -> None:
        """Precede a touch by another gesture; from TURNING_FRAMES after the change on, the later is right."""
        earlier = self._partner(recording)
        if earlier is None:
            return
        changes = int(self.made.integers(EARLIEST_CHANGE, LATEST_CHANGE))
        later = np.zeros(self.own.window)
        later[changes:] = ((np.arange(self.own.window - changes) + 1) / FADE_FRAMES).clip(0.0, 1.0)
        share = later[:, None, None]
        window = (1.0 - share) * self._piece(earlier) + share * self._piece(recording)
        batch.counts[place] = torch.from_numpy(window.astype(np.float32))
        is_before = batch.lengths[place] <= changes
        first = functional.one_hot(self.classes[earlier], len(self.labels)).float()
        batch.targets[place, is_before] = first
        asked = (is_before | (batch.lengths[place] >= changes + TURNING_FRAMES)).float()
        batch.weights[place] = asked / asked.mean().clamp_min(0.2)
        batch.taught[place] = 0.0

    def _add_hand(self, batch: Touches, place: int, recording: int, still: Tensor) -> None:
        """Add a second hand, which makes another gesture; both are half right."""
        other = self._partner(recording)
        if other is None:
            return
        above = self._piece(recording) - still.numpy()
        window = (self._piece(other) + above).clip(0.0, MAX_COUNT)
        batch.counts[place] = torch.from_numpy(window.astype(np.float32))
        second = functional.one_hot(self.classes[other], len(self.labels)).float()
        batch.targets[place] = 0.5 * (batch.targets[place] + second)
        batch.weights[place] = 1.0
        batch.taught[place] = 0.0

    def _on_pads(self, windows: Tensor, soft: Tensor, made_soft: Tensor) -> Tensor:
        """Return the windows, many of them as another kind of pad would read them."""
        varied = self.own.augmentation
        fabric = as_quiet_pad(as_another_pad(windows, varied, self.rng), varied, self.rng)
        always = msgspec.structs.replace(varied, another_pad=1.0, coarse=1.0)
        is_sharp = (torch.rand(len(windows)) < self.refined.sharpened) & ~made_soft
        sharp = windows
        if len(self._fabric_rests):
            chosen = self._fabric_rests[torch.randint(len(self._fabric_rests), (len(windows),))]
            as_it_is = msgspec.structs.replace(varied, published_framing=0.0)
            rests = crop(self.frames, chosen, windows.shape[1], as_it_is, self.rng)
            sharp = torch.where(is_sharp[:, None, None, None], as_fabric(windows) + rests, windows)
        sharp = torch.where(made_soft[:, None, None, None], as_another_pad(windows, always, self.rng), sharp)
        return torch.where(soft[:, None, None, None], sharp, fabric).clamp(0.0, MAX_COUNT)

    def _mix(self, batch: Touches, soft: Tensor) -> Touches:
        """Blend some windows with others on the network's logarithmic scale, as in `windows`."""
        B = len(soft)
        share = (0.5 * torch.rand(B) * (torch.rand(B) < self.own.augmentation.mix))[:, None]
        other = torch.randperm(B)
        knee = self.own.network.knee_counts
        levels = torch.log(batch.counts + knee)
        counts = torch.exp(torch.lerp(levels, levels[other], share[:, :, None, None])) - knee
        targets = torch.lerp(batch.targets, batch.targets[other], share[:, :, None])
        takes_part = share[:, 0] > 0
        is_soft = soft | (soft[other] & takes_part)
        unknown = torch.lerp(batch.unknown, batch.unknown[other], share[:, 0])
        # The third study has no tickle. But of an unknown touch it is certain that it is none.
        masked = is_soft[:, None] & self.missing & (unknown == 0.0)[:, None]
        possible = ~masked | (targets.amax(dim=1) > 0)
        taught = torch.where(takes_part, torch.minimum(batch.taught, batch.taught[other]), batch.taught)
        return Touches(counts, batch.lengths, batch.weights, targets, possible, taught, unknown)


def as_fabric(counts: Tensor) -> Tensor:
    """Return (B, T, 8, 8) of the third study's soft pad as a fabric would have read them: sharper, stronger.

    Its creep is undone in part, by amplifying falls like the inverse of a low-pass filter; its blur by
    unsharp masking.
    """
    B = len(counts)
    strength, kept, gain, power = torch.rand(4, B, 1, 1, 1)
    flat = counts.flatten(0, 1)[:, None]
    blurred = functional.avg_pool2d(functional.pad(flat, (1, 1, 1, 1), mode="replicate"), 3, stride=1)
    sharp = counts + (0.2 + strength) * (counts - blurred.reshape(counts.shape))
    change = functional.pad(sharp[:, 1:] - sharp[:, :-1], (0, 0, 0, 0, 1, 0))
    sharp = (sharp + 8.0 * kept * change.clamp_max(0.0)).clamp_min(0.0)
    read: Tensor = (sharp / 100.0) ** (1.0 + 0.4 * power) * 100.0 * torch.exp(1.2 * gain)
    return read
