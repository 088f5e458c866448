"""Cached features of the frozen backbone.

Adapting changes only the head: the dense layers after the touch's summary features. So each crop passes
through the backbone once, however many heads are trained on it.
"""

import copy
from collections.abc import Sequence
from dataclasses import dataclass

import msgspec
import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn
from tqdm import tqdm

from touchd.drivers.frame import NO_TOUCH
from touchd.drivers.recording import Recording
from touchd.model.adapt.augment import Frames, begin_from_rest, crop, vary
from touchd.model.adapt.passing import WINDOW_FRAMES, InPassing
from touchd.model.settings import LENGTHS, AugmentationSettings
from touchd.model.tgc import TGC

LEARNT_LENGTHS = (54, 81, 108, 144)
BATCH = 64
# A progress bar without tqdm's rate, which does not help somebody who waits.
BAR = "{desc}: {n_fmt} of {total_fmt} |{bar}| {elapsed}"
# A recording shorter than a crop is used from its start, at its own pace; its last frame is repeated.
AS_IT_IS = {"published_framing": 0.0, "change_pace": 0.0, "onset": 0.0}
# The tracker dates a touch up to three frames too early or two too late.
EARLIEST_FRAMES, LATEST_FRAMES = 3, 2
# The daemon answers an ended touch 13 frames after its last contact.
AFTER_FRAMES = 13
ANSWERED_FRAMES = (9, 20)
PACE = 0.2


@dataclass(frozen=True, eq=False)
class CropFeatures:
    """Summaries of varied crops: values (N, crops, 4, features), at each of LEARNT_LENGTHS.

    Those of a touch in passing that is over by then are after its end.
    within: (N, 4) bool, whether the recording is that long. gestures: (N,) names.
    """

    values: Tensor
    within: Tensor
    gestures: tuple[str, ...]

    def of(self, recordings: Sequence[int]) -> "CropFeatures":
        chosen = torch.tensor(recordings, dtype=torch.long)
        return CropFeatures(
            self.values[chosen], self.within[chosen], tuple(self.gestures[i] for i in recordings)
        )


@dataclass(frozen=True, eq=False)
class WindowFeatures:
    """Summaries of the windows of one length: values (W, features), recordings (W,) they are cut from."""

    values: Tensor
    recordings: NDArray[np.int64]


def split(network: TGC) -> tuple[TGC, nn.Sequential]:
    """Return the backbone, which outputs summaries instead of logits, and the head."""
    backbone = copy.deepcopy(network)
    backbone.dense = nn.Sequential()
    return backbone.eval().requires_grad_(False), copy.deepcopy(network.dense)


def crops(
    backbone: TGC, recordings: Sequence[Recording], settings: AugmentationSettings, each: int, seed: int
) -> CropFeatures:
    """Return summaries of `each` random crops of every recording, varied as in training."""
    rng = torch.Generator().manual_seed(seed)
    counts = [torch.from_numpy(recording.counts.astype(np.float32)) for recording in recordings]
    resting = _resting(recordings)
    length = LEARNT_LENGTHS[-1]
    frames = Frames.of([_filled(each, length) for each in counts])
    values = []
    shown = tqdm(recordings, desc="preparing", bar_format=BAR, leave=False, disable=None)
    for i, recording in enumerate(shown):
        if isinstance(recording, InPassing):
            touches, ends = varied_touches(recording, each, rng)
            values.append(backbone.at_own_lengths(vary(touches, settings, rng), ends))
            continue
        own = settings
        if len(counts[i]) <= length:
            own = msgspec.structs.replace(settings, **AS_IT_IS)
        windows = crop(frames, torch.full((each,), i), length, own, rng)
        if rests := resting.get(recording.participant, resting.get(None, [])):
            chosen = torch.tensor(rests)[torch.randint(len(rests), (each,), generator=rng)]
            still = crop(frames, chosen, length, msgspec.structs.replace(own, **AS_IT_IS), rng)
            windows = begin_from_rest(windows, still, own, rng)
        values.append(backbone.at_lengths(vary(windows, settings, rng), LEARNT_LENGTHS))
    lengths = torch.tensor(
        [length if isinstance(recording, InPassing) else len(recording.counts) for recording in recordings]
    )
    within = lengths[:, None] >= torch.tensor(LEARNT_LENGTHS)
    return CropFeatures(torch.stack(values), within, tuple(recording.gesture for recording in recordings))


def windows(backbone: TGC, recordings: Sequence[Recording]) -> dict[int, WindowFeatures]:
    """Return the summaries of consecutive windows, cut as HAART's are, for each answered length."""
    found = {}
    for length in LENGTHS:
        cut = [
            (owner, recording.counts[start : start + length])
            for owner, recording in enumerate(recordings)
            if not isinstance(recording, InPassing)
            for start in _starts(len(recording.counts), length)
        ]
        values = [torch.zeros(0, 3 * backbone.settings.width)]
        for i in range(0, len(cut), BATCH):
            batch = np.stack([window for _, window in cut[i : i + BATCH]])
            values.append(backbone(torch.from_numpy(batch.astype(np.float32))))
        owners = np.array([owner for owner, _ in cut], dtype=np.int64)
        found[length] = WindowFeatures(torch.cat(values), owners)
    return found


def ended(backbone: TGC, recordings: Sequence[Recording]) -> WindowFeatures:
    """Return the summaries of touches in passing when the daemon answers them."""
    owners = [i for i, recording in enumerate(recordings) if isinstance(recording, InPassing)]
    if not owners:
        return WindowFeatures(torch.zeros(0, 3 * backbone.settings.width), np.zeros(0, np.int64))
    touches, lengths = when_answered([each for each in recordings if isinstance(each, InPassing)])
    values = [
        backbone.at_own_lengths(touches[i : i + BATCH], lengths[i : i + BATCH]).squeeze(1)
        for i in range(0, len(owners), BATCH)
    ]
    return WindowFeatures(torch.cat(values), np.array(owners, dtype=np.int64))


def _starts(frames: int, length: int) -> list[int]:
    """Return the windows' first frames; a realigned recording is one frame short, so its last is earlier."""
    if frames < length:
        return []
    return [min(window * length, frames - length) for window in range((frames + 1) // length)]


def _resting(recordings: Sequence[Recording]) -> dict[str | None, list[int]]:
    """Return each participant's recordings at rest, and everybody's under None."""
    resting: dict[str | None, list[int]] = {}
    for i, recording in enumerate(recordings):
        if recording.gesture == NO_TOUCH:
            for name in (recording.participant, None):
                resting.setdefault(name, []).append(i)
    return resting


def _filled(counts: Tensor, length: int) -> Tensor:
    """Return at least `length` frames, the last one repeated where there are fewer."""
    missing = max(0, length - len(counts))
    return torch.cat([counts, counts[-1:].expand(missing, -1, -1)]) if missing else counts


def varied_touches(recording: InPassing, each: int, rng: torch.Generator) -> tuple[Tensor, Tensor]:
    """Return (each, WINDOW_FRAMES, 8, 8) counts at random paces, and lengths (each, 4) to answer at."""
    lead = torch.randint(-LATEST_FRAMES, EARLIEST_FRAMES + 1, (each,), generator=rng).float()
    pace = 1.0 + PACE * (2.0 * torch.rand(each, generator=rng) - 1.0)
    least, most = ANSWERED_FRAMES
    wait = torch.randint(least, most + 1, (each, len(LEARNT_LENGTHS)), generator=rng)
    over = lead + (recording.over - recording.first) / pace
    ends = (over[:, None].ceil().long() + wait).clamp(1, WINDOW_FRAMES)
    # At the usual lengths while the touch still goes on, else after its end.
    usual = torch.tensor(LEARNT_LENGTHS).expand(each, -1)
    return _laid(recording, lead, pace), torch.where(usual <= over[:, None], usual, ends)


def when_answered(recordings: Sequence[InPassing]) -> tuple[Tensor, Tensor]:
    """Return (N, WINDOW_FRAMES, 8, 8) counts and the lengths (N, 1) after which the daemon answers."""
    windows = [_laid(each, torch.tensor([float(EARLIEST_FRAMES)]), torch.ones(1)) for each in recordings]
    lengths = [each.over - each.first + EARLIEST_FRAMES + AFTER_FRAMES for each in recordings]
    return torch.cat(windows), torch.tensor(lengths)[:, None].clamp(1, WINDOW_FRAMES)


def _laid(recording: InPassing, lead: Tensor, pace: Tensor) -> Tensor:
    """Return (B, WINDOW_FRAMES, 8, 8) counts from `lead` (B,) frames before the touch on, at a pace (B,)."""
    counts = torch.from_numpy(recording.counts.astype(np.float32))
    ticks = torch.arange(WINDOW_FRAMES)
    places = recording.first + (ticks - lead[:, None]) * pace[:, None]
    # The rest goes on, to and fro, where the recording ends.
    last = len(counts) - 1
    span = max(1, last - recording.over)
    beyond = (places - last).clamp_min(0.0)
    folded = last - (span - ((beyond % (2 * span)) - span).abs())
    places = torch.where(places > last, folded, places).clamp(0.0, last)
    below = places.floor().clamp_max(max(0, last - 1)).long()
    part = (places - below)[:, :, None, None]
    return torch.lerp(counts[below], counts[(below + 1).clamp_max(last)], part)
