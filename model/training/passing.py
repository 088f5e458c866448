"""Windows of touches in passing: a hand makes one or a few contacts and leaves; then the pad rests.

The recordings show hands that repeat a gesture without a pause. A window is made from a part of one: complete
contacts of a pat or stroke, or a piece of another gesture, with rest of the same pad before and after.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from touchd.drivers.frame import NO_TOUCH, OTHER, ROWS
from touchd.drivers.recording import Recording
from touchd.model.adapt.augment import Frames
from touchd.model.adapt.backbone import ANSWERED_FRAMES, EARLIEST_FRAMES, LATEST_FRAMES, PACE
from touchd.model.training.contacts import LEAVES, contacts, rests_of, shift_of_rest

# A piece of a gesture without lift-offs, or several contacts together, last 0.3 to 2.2 s.
LEAST_FRAMES, MOST_FRAMES = 16, 118
# The load rises and falls within this many frames; a soft pad creeps back, so its load falls more slowly.
FADE_FRAMES, SOFT_FADE_FRAMES = 4.0, 24.0
# Answers have no weight from a second after the last contact on.
FORGOTTEN_FRAMES = 54
# The most contacts of a touch beyond the first; few are drawn more often than many.
MORE_CONTACTS = {"pat": 6, "stroke": 3, OTHER: 4}


@dataclass(frozen=True, eq=False)
class Passing:
    """Tables by recording, from which such windows are made on one device.

    starts, stops: (R, most) frames of complete contacts. contacts: (R,) how many; 0: the gesture has none.
    more: (R,) the most contacts beyond the first. touches: (R,) bool, False at rest and where no rest is
    known. rests, rest_counts: (R, most), (R,) recordings at rest. shifts: (R, 8, 8) counts by which a touch
    shifts the rest. soft: (R,) bool.
    """

    starts: Tensor
    stops: Tensor
    contacts: Tensor
    more: Tensor
    touches: Tensor
    rests: Tensor
    rest_counts: Tensor
    shifts: Tensor
    soft: Tensor

    @classmethod
    def of(cls, recordings: Sequence[Recording], soft: Sequence[bool], device: str) -> "Passing":
        """Find the contacts of each recording, and its rest."""
        rests = rests_of(recordings)
        found = [
            contacts(each, is_soft=is_soft) if each.gesture in (*LEAVES, OTHER) else []
            for each, is_soft in zip(recordings, soft, strict=True)
        ]
        shifts = [_shift(recordings, *each) for each in zip(recordings, rests, strict=True)]
        is_touch = [
            each.gesture != NO_TOUCH and bool(resting)
            for each, resting in zip(recordings, rests, strict=True)
        ]
        return cls(
            starts=_table([[first for first, _ in each] for each in found]).to(device),
            stops=_table([[stop for _, stop in each] for each in found]).to(device),
            contacts=torch.tensor([len(each) for each in found], device=device),
            more=torch.tensor([MORE_CONTACTS.get(each.gesture, 0) for each in recordings], device=device),
            touches=torch.tensor(is_touch, device=device),
            rests=_table(rests).to(device),
            rest_counts=torch.tensor([len(each) for each in rests], device=device),
            shifts=torch.from_numpy(np.stack(shifts)).to(device),
            soft=torch.tensor(soft, device=device),
        )

    def some(
        self,
        frames: Frames,
        chosen: Tensor,
        windows: Tensor,
        lengths: Tensor,
        share: float,
        rng: torch.Generator,
    ) -> tuple[Tensor, Tensor, Tensor]:
        """Replace a share of the windows (B, T, 8, 8) of touches by touches in passing.

        lengths: (B, K) frames after which windows are answered. Returns windows; lengths (B, K + 1), the last
        one after the touch's end; and weights of the answers in the loss, (B, K + 1).
        """
        B, T = windows.shape[:2]
        is_passing = (torch.rand(B, generator=rng, device=rng.device) < share) & self.touches[chosen]
        made, over = self._windows(frames, chosen, T, rng)
        windows = torch.where(is_passing[:, None, None, None], made, windows)
        least, most = ANSWERED_FRAMES
        wait = torch.randint(least, most, (B,), generator=rng, device=rng.device)
        anywhere = torch.randint(least, T + 1, (B,), generator=rng, device=rng.device)
        end = torch.where(is_passing, (over + wait).clamp_max(T), anywhere)
        lengths = torch.cat([lengths, end[:, None]], dim=1)
        is_forgotten = is_passing[:, None] & (lengths > over[:, None] + FORGOTTEN_FRAMES)
        weights = (~is_forgotten).float()
        return windows, lengths, weights / weights.mean(dim=1, keepdim=True)

    def _windows(self, frames: Frames, chosen: Tensor, T: int, rng: torch.Generator) -> tuple[Tensor, Tensor]:
        """Return windows (B, T, 8, 8) of touches in passing, and the frame after each touch (B,)."""
        B = len(chosen)

        def uniform(*shape: int) -> Tensor:
            return torch.rand(B, *shape, generator=rng, device=rng.device)

        start, stop = self._touch(frames, chosen, uniform(4))
        pace = 1.0 + PACE * (2.0 * uniform() - 1.0)
        lead = (uniform() * (EARLIEST_FRAMES + LATEST_FRAMES + 1)).floor() - LATEST_FRAMES
        over = lead + (stop - start) / pace
        ticks = torch.arange(T, device=chosen.device).float()
        touched = _at(frames, chosen, start[:, None] + (ticks - lead[:, None]) * pace[:, None])
        resting = self.rests[chosen, (uniform() * self.rest_counts[chosen]).long()]
        begin = uniform() * (frames.lengths[resting] - T).clamp_min(0)
        rest = _at(frames, resting, begin[:, None] + ticks)
        is_shifted = (uniform() < 0.5)[:, None, None]
        rest = rest + (self.shifts[chosen] * is_shifted)[:, None]
        longest = torch.where(self.soft[chosen], SOFT_FADE_FRAMES, FADE_FRAMES)
        rise, fall = 1.0 + uniform() * (FADE_FRAMES - 1.0), 1.0 + uniform() * (longest - 1.0)
        comes = (ticks - lead[:, None] + 1.0) / rise[:, None]
        goes = 1.0 - (ticks - over[:, None]) / fall[:, None]
        contact = torch.minimum(comes, goes).clamp(0.0, 1.0)
        return torch.lerp(rest.clamp_min(0.0), touched, contact[:, :, None, None]), over.ceil().long()

    def _touch(self, frames: Frames, chosen: Tensor, chance: Tensor) -> tuple[Tensor, Tensor]:
        """Return the first frame and the one after the last, (B,) each, of a touch; chance: (B, 4)."""
        first, more, length, place = chance.unbind(1)
        count = self.contacts[chosen]
        begun = (first * count).long()
        ended = begun + (more**2 * self.more[chosen]).long()
        ended = torch.minimum(ended, (count - 1).clamp_min(0))
        start, stop = self.starts[chosen, begun], self.stops[chosen, ended]
        stop = torch.where(stop - start > MOST_FRAMES, self.stops[chosen, begun], stop)
        longest = torch.minimum(frames.lengths[chosen] - 2, torch.tensor(MOST_FRAMES, device=count.device))
        piece = LEAST_FRAMES + length**2 * (longest - LEAST_FRAMES)
        anywhere = place * (frames.lengths[chosen] - 1 - piece)
        has_contacts = count > 0
        return (
            torch.where(has_contacts, start.float(), anywhere),
            torch.where(has_contacts, stop.float(), anywhere + piece),
        )


def _table(rows: Sequence[Sequence[int]]) -> Tensor:
    """Return (R, most) rows of different lengths, filled up with zeros."""
    filled = torch.zeros(len(rows), max(1, *map(len, rows)), dtype=torch.long)
    for row, values in zip(filled, rows, strict=True):
        row[: len(values)] = torch.tensor(values, dtype=torch.long)
    return filled


def _shift(recordings: Sequence[Recording], touch: Recording, rests: Sequence[int]) -> NDArray[np.float32]:
    """Return by how much (8, 8) counts of rest under a touch differ from those of the pad at rest."""
    if touch.gesture in (*LEAVES, "tickle") and rests:
        return shift_of_rest(touch.counts, recordings[rests[0]].counts)
    return np.zeros((ROWS, ROWS), np.float32)


def _at(frames: Frames, chosen: Tensor, places: Tensor) -> Tensor:
    """Return (B, T, 8, 8) counts of the recordings `chosen` at places (B, T) in frames, held at both ends."""
    last = (frames.lengths[chosen] - 1)[:, None].float()
    places = torch.minimum(places.clamp_min(0.0), last)
    below = torch.minimum(places.floor(), last - 1.0)
    part = (places - below)[:, :, None, None]
    first = (frames.starts[chosen][:, None] + below.long()) * ROWS
    rows = first[:, :, None] + torch.arange(ROWS, device=places.device)
    return torch.lerp(frames.rows[rows], frames.rows[rows + ROWS], part)
