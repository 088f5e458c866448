"""Cached features of the frozen backbone.

Adapting changes only the head: the dense layers after the summary of a touch. So each crop passes through the
backbone once, however many heads are trained on it.
"""

import copy
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TypeAlias

import msgspec
import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn
from tqdm import tqdm

from touchd.drivers.frame import NO_TOUCH
from touchd.drivers.recording import Recording
from touchd.model.adapt.augment import Frames, begin_from_rest, crop, vary
from touchd.model.adapt.passing import IN_PASSING, WINDOW_FRAMES, InPassing
from touchd.model.settings import LENGTHS, AugmentationSettings
from touchd.model.tgc import TGC

LEARNT_LENGTHS = (54, 81, 108, 144)
BATCH = 64
# Samples of each remembered Gaussian, and the names of its arrays in a file.
SAMPLES = 128
ARRAYS = ("means", "directions", "rests")
# A recording shorter than a crop is used from its start, at its own pace; its last frame is repeated.
AS_IT_IS = {"published_framing": 0.0, "change_pace": 0.0, "onset": 0.0}
# A touch's first frame is up to three frames too early or two too late.
EARLIEST_FRAMES, LATEST_FRAMES = 3, 2
# The daemon answers an ended touch 13 frames after its last contact; training varies this, and the pace.
AFTER_FRAMES = 13
ANSWERED_FRAMES = (9, 20)
PACE = 0.2
Window: TypeAlias = tuple[int, NDArray[np.generic], int]
"""The recording's number, counts (T, 8, 8), and after how many of them to answer."""


@dataclass(frozen=True, eq=False)
class CropFeatures:
    """Summaries of varied crops: values (N, crops, 4, features), at each of LEARNT_LENGTHS.

    If a touch in passing has ended by then, its summary is that after its end.
    within: (N, 4) bool, whether the recording is that long. gestures: (N,) names.
    """

    values: Tensor
    within: Tensor
    gestures: tuple[str, ...]

    def of(self, recordings: Sequence[int]) -> "CropFeatures":
        chosen, gestures = list(recordings), tuple(self.gestures[i] for i in recordings)
        return CropFeatures(self.values[chosen], self.within[chosen], gestures)


@dataclass(frozen=True, eq=False)
class Remembered:
    """Gaussians of the features of the training recordings; samples of them stand for other people.

    A head that is adapted to one person would forget the others; the samples replace their recordings
    (generative feature replay, Liu et al. 2020). There is one Gaussian for each study, gesture and length
    (N, L): its principal axes and each feature's residual.
    means, rests: (N, L, features); rests are residual standard deviations. directions: (N, L, R, features),
    each scaled by its standard deviation. gestures: (N,) names.
    """

    means: Tensor
    directions: Tensor
    rests: Tensor
    gestures: tuple[str, ...]

    def samples(self, gestures: Iterable[str], seed: int) -> CropFeatures:
        """Draw SAMPLES summaries from each study's Gaussian for each of these gestures."""
        rng = torch.Generator().manual_seed(seed)
        chosen = [i for wanted in gestures for i, own in enumerate(self.gestures) if own == wanted]
        N, L, R, F = self.directions[chosen].shape
        along = torch.randn(N, SAMPLES, L, R, generator=rng)
        values = torch.einsum("nslr,nlrf->nslf", along, self.directions[chosen])
        values = values + self.rests[chosen].unsqueeze(1) * torch.randn(N, SAMPLES, L, F, generator=rng)
        values = values + self.means[chosen].unsqueeze(1)
        names = tuple(self.gestures[i] for i in chosen)
        return CropFeatures(values, torch.ones(N, L, dtype=torch.bool), names)

    @classmethod
    def load(cls, path: Path) -> "Remembered":
        """Read them from an .npz file."""
        with np.load(path) as stored:
            means, directions, rests = (torch.from_numpy(stored[name].astype(np.float32)) for name in ARRAYS)
            return cls(means, directions, rests, tuple(stored["gestures"].tolist()))


@dataclass(frozen=True, eq=False)
class WindowFeatures:
    """Summaries of windows: values (W, features), recordings (W,) they are cut from."""

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
    longest = LEARNT_LENGTHS[-1]
    frames = Frames.of([_filled(recording.counts, longest) for recording in recordings])
    lengths = [longest if isinstance(each, InPassing) else len(each.counts) for each in recordings]
    resting = [i for i, recording in enumerate(recordings) if recording.gesture == NO_TOUCH]
    still = msgspec.structs.replace(settings, **AS_IT_IS)
    usual = torch.tensor([LEARNT_LENGTHS])
    values = []
    for i, recording in enumerate(tqdm(recordings, desc="preparing", leave=False, disable=None)):
        if isinstance(recording, InPassing):
            windows, answered = _varied_touches(recording, each, rng)
        else:
            own = settings if lengths[i] > longest else still
            windows, answered = crop(frames, torch.full((each,), i), longest, own, rng), usual
            own_rests = [j for j in resting if recordings[j].participant == recording.participant]
            if rests := own_rests or resting:
                chosen = torch.tensor(rests)[torch.randint(len(rests), (each,), generator=rng)]
                windows = begin_from_rest(windows, crop(frames, chosen, longest, still, rng), own, rng)
        values.append(backbone.at_lengths(vary(windows, settings, rng), answered))
    within = torch.tensor(lengths)[:, None] >= usual
    return CropFeatures(torch.stack(values), within, tuple(recording.gesture for recording in recordings))


def windows(backbone: TGC, recordings: Sequence[Recording]) -> dict[int, WindowFeatures]:
    """Return the summaries of consecutive windows, cut as HAART's are, for each answered length.

    At IN_PASSING: of touches in passing, when the daemon answers them.
    """
    cut: dict[int, list[Window]] = {length: [] for length in (IN_PASSING, *LENGTHS)}
    for i, recording in enumerate(recordings):
        if isinstance(recording, InPassing):
            cut[IN_PASSING].append((i, *_when_answered(recording)))
            continue
        frames = len(recording.counts)
        for length in (length for length in LENGTHS if length <= frames):
            # A realigned recording is one frame short, so its last window begins earlier.
            for start in range(0, frames - length + 2, length):
                first = min(start, frames - length)
                cut[length].append((i, recording.counts[first : first + length], length))
    return {length: _summaries(backbone, own) for length, own in cut.items()}


def _summaries(backbone: TGC, cut: Sequence[Window]) -> WindowFeatures:
    values = [torch.zeros(0, 3 * backbone.settings.width)]
    for i in range(0, len(cut), BATCH):
        _, counts, lengths = zip(*cut[i : i + BATCH], strict=True)
        batch = torch.from_numpy(np.stack(counts).astype(np.float32))
        values.append(backbone.at_lengths(batch, torch.tensor(lengths)[:, None]).squeeze(1))
    return WindowFeatures(torch.cat(values), np.array([i for i, *_ in cut], dtype=np.int64))


def _filled(counts: NDArray[np.generic], length: int) -> Tensor:
    """Return at least `length` frames, the last one repeated where there are fewer."""
    missing = max(0, length - len(counts))
    return torch.from_numpy(np.pad(counts.astype(np.float32), ((0, missing), (0, 0), (0, 0)), "edge"))


def _varied_touches(recording: InPassing, each: int, rng: torch.Generator) -> tuple[Tensor, Tensor]:
    """Return (each, WINDOW_FRAMES, 8, 8) counts at random paces, and lengths (each, 4) to answer at."""
    lead = torch.randint(-LATEST_FRAMES, EARLIEST_FRAMES + 1, (each,), generator=rng).float()
    pace = 1.0 + PACE * (2.0 * torch.rand(each, generator=rng) - 1.0)
    least, most = ANSWERED_FRAMES
    wait = torch.randint(least, most + 1, (each, len(LEARNT_LENGTHS)), generator=rng)
    over = lead + (recording.over - recording.first) / pace
    ends = (over[:, None].ceil().long() + wait).clamp(1, WINDOW_FRAMES)
    # At the usual lengths while the touch still goes on, else after its end.
    usual = torch.tensor([LEARNT_LENGTHS])
    return _laid(recording, lead, pace), torch.where(usual <= over[:, None], usual, ends)


def _when_answered(recording: InPassing) -> tuple[NDArray[np.float32], int]:
    """Return (WINDOW_FRAMES, 8, 8) counts and the number of frames after which the daemon answers."""
    (window,) = _laid(recording, torch.tensor([float(EARLIEST_FRAMES)]), torch.ones(1)).numpy()
    return window, min(recording.over - recording.first + EARLIEST_FRAMES + AFTER_FRAMES, WINDOW_FRAMES)


def _laid(recording: InPassing, lead: Tensor, pace: Tensor) -> Tensor:
    """Return (B, WINDOW_FRAMES, 8, 8) counts from `lead` (B,) frames before the touch on, at a pace (B,)."""
    counts = torch.from_numpy(recording.counts.astype(np.float32))
    ticks = torch.arange(WINDOW_FRAMES)
    places = recording.first + (ticks - lead[:, None]) * pace[:, None]
    # After the end of the recording, the rest is played backwards and forwards.
    last = len(counts) - 1
    span = max(1, last - recording.over)
    beyond = (places - last).clamp_min(0.0)
    folded = last - (span - ((beyond % (2 * span)) - span).abs())
    places = torch.where(places > last, folded, places).clamp(0.0, last)
    below = places.floor().clamp_max(max(0, last - 1)).long()
    part = (places - below)[:, :, None, None]
    return torch.lerp(counts[below], counts[(below + 1).clamp_max(last)], part)
