"""Our touch-gesture classifier (TGC): causal, one network for every length.

A convolutional stem sees each frame and its change, gated dilated convolutions follow the motion, transformer
encoder blocks relate it over the touch, and dense layers name the gesture. Everything from raw counts to
logits is inside the network, so that training and robot cannot drift apart.
"""

import math

import torch
from torch import Tensor, nn
from torch.nn import functional

from touchd.drivers.frame import COLUMNS, ROWS
from touchd.model.settings import NetworkSettings

VARIANCE_FLOOR = 1e-5
# A distance at which even the least of the attention's slopes leaves no weight.
FAR_FRAMES = 1e6
# Of log(4 + counts) and of its change between frames, over the HAART training recordings.
LEVEL_MEAN = math.log(4.0) + 0.69
LEVEL_SPREAD = 0.61
CHANGE_SPREAD = 0.21


class FeatureDropout(nn.Module):
    """Drop whole features of (B, T, width), the same ones in every frame of a touch."""

    def __init__(self, probability: float) -> None:
        super().__init__()
        self.probability = probability

    def forward(self, x: Tensor) -> Tensor:
        """Return x, in training with features dropped and the rest scaled up."""
        if not self.training or self.probability == 0.0:
            return x
        kept = torch.full((x.shape[0], 1, x.shape[2]), 1.0 - self.probability, device=x.device)
        return x * torch.bernoulli(kept) / (1.0 - self.probability)


class FrameStem(nn.Module):
    """Embed each frame and its change since the one before: (B, T, 8, 8) counts to (B, T, width)."""

    plane_weights: Tensor
    taps: Tensor

    def __init__(self, settings: NetworkSettings) -> None:
        super().__init__()
        stem_width, width = settings.stem_width, settings.width
        self.knee_counts = settings.knee_counts
        weights = _planes(settings.smooth_frames)
        planes, frames = weights.shape
        self.past = frames - 1
        self.register_buffer("plane_weights", weights, persistent=False)
        self.register_buffer("taps", torch.arange(frames), persistent=False)
        self.convolutions = nn.Sequential(
            nn.Conv2d(planes, stem_width, 3, padding=1),
            nn.ReLU(),
            nn.AvgPool2d(2),
            nn.Conv2d(stem_width, 2 * stem_width, 3, padding=1),
            nn.ReLU(),
            nn.AvgPool2d(2),
        )
        self.embed = nn.Linear(2 * stem_width * (ROWS // 4) * (COLUMNS // 4), width)
        self.norm = nn.LayerNorm(width)
        self.dropout = FeatureDropout(settings.dropout)

    def forward(self, counts: Tensor) -> Tensor:
        """Return (B, T, width) from (B, T, 8, 8) counts."""
        level = self.level(counts)
        return self.embed_level(level, level[:, :1].expand(-1, self.past, -1, -1))

    def level(self, counts: Tensor) -> Tensor:
        """Return counts on the scale on which the network sees them, less the recordings' mean."""
        return torch.log(counts + self.knee_counts) - LEVEL_MEAN

    def embed_level(self, level: Tensor, last: Tensor) -> Tensor:
        """Return (B, T, width) from (B, T, 8, 8) levels and those before them, (B, past, 8, 8).

        A touch's first frame stands for those before it.
        """
        B, T = level.shape[:2]
        seen = torch.cat([last, level], dim=1)
        pixels = _at(seen, T, self.taps).reshape(B * T, -1, ROWS, COLUMNS)
        # Planes and convolution are both linear in the levels, so one convolution does both.
        first, *others = self.convolutions
        assert isinstance(first, nn.Conv2d)
        weight = torch.einsum("opyx,pt->otyx", first.weight, self.plane_weights)
        features = _convolve(pixels, weight, first.bias)
        for layer in others:
            if isinstance(layer, nn.Conv2d):
                features = _convolve(features, layer.weight, layer.bias)
            else:
                features = layer(features)
        embedded: Tensor = self.norm(self.dropout(self.embed(features.reshape(B * T, -1)).reshape(B, T, -1)))
        return embedded


class GatedConvolution(nn.Module):
    """A causal dilated convolution over time with a gate and a residual: (B, T, width) to the same."""

    taps: Tensor

    def __init__(self, width: int, dilation: int, dropout: float) -> None:
        super().__init__()
        self.past = 2 * dilation
        self.convolution = nn.Conv1d(width, 2 * width, 3, dilation=dilation)
        self.project = nn.Linear(width, width)
        self.register_buffer("taps", torch.arange(3) * dilation, persistent=False)
        self.norm = nn.LayerNorm(width)
        self.dropout = FeatureDropout(dropout)

    def forward(self, x: Tensor) -> Tensor:
        """Return (B, T, width); frame t sees frames up to t."""
        return self.follow(x, functional.pad(x, (0, 0, self.past, 0)))

    def follow(self, x: Tensor, padded: Tensor) -> Tensor:
        """Return (B, T, width) from as many frames x; padded: the same with the `past` frames before them."""
        B, T, width = x.shape
        # One matrix product: of a few frames, ONNX Runtime's convolution takes up to three times as long.
        seen = _at(padded, T, self.taps).reshape(B * T, 3 * width)
        weight = self.convolution.weight.transpose(1, 2).flatten(1)
        signal, gate = functional.linear(seen, weight, self.convolution.bias).chunk(2, dim=-1)
        change = self.project(torch.tanh(signal) * torch.sigmoid(gate)).reshape(B, T, width)
        updated: Tensor = self.norm(x + self.dropout(change))
        return updated


class EncoderBlock(nn.Module):
    """A causal pre-norm transformer encoder block that penalises distance (ALiBi, Press et al. 2022)."""

    slopes: Tensor

    def __init__(self, width: int, heads: int, feed_forward: int, dropout: float) -> None:
        super().__init__()
        self.heads = heads
        self.attention_norm = nn.LayerNorm(width)
        self.query_key_value = nn.Linear(width, 3 * width)
        self.project = nn.Linear(width, width)
        self.feed_forward = nn.Sequential(
            nn.LayerNorm(width), nn.Linear(width, feed_forward), nn.GELU(), nn.Linear(feed_forward, width)
        )
        self.dropout = FeatureDropout(dropout)
        slopes = torch.tensor([2.0 ** (-8.0 * (h + 1) / heads) for h in range(heads)])
        self.register_buffer("slopes", slopes.reshape(1, heads, 1, 1), persistent=False)

    def forward(self, x: Tensor) -> Tensor:
        """Return (B, T, width); frame t attends to frames up to t."""
        query, key_value = self.project_in(x)
        return self.attend(x, query, key_value)

    def project_in(self, x: Tensor) -> tuple[Tensor, Tensor]:
        """Return queries (B, heads, T, width / heads); keys and values (B, 2 * heads, T, width / heads)."""
        B, T, width = x.shape
        packed = self.query_key_value(self.attention_norm(x)).reshape(
            B, T, 3 * self.heads, width // self.heads
        )
        query, key_value = packed.transpose(1, 2).split([self.heads, 2 * self.heads], dim=1)
        return query, key_value

    def attend(self, x: Tensor, query: Tensor, key_value: Tensor) -> Tensor:
        """Return (B, T, width) from the frames x; keys and values may begin with those of frames before."""
        B, T, width = x.shape
        key, value = key_value.chunk(2, dim=1)
        seen = torch.arange(key.shape[2], device=x.device)
        newest = torch.arange(key.shape[2] - T, key.shape[2], device=x.device)
        distance = (newest[:, None] - seen).to(x.dtype)  # (T, M + T)
        bias = -self.slopes * torch.where(distance < 0, FAR_FRAMES, distance)
        scores = query @ key.transpose(-1, -2) / math.sqrt(width // self.heads) + bias
        mixed = (torch.softmax(scores, dim=-1) @ value).transpose(1, 2).reshape(B, T, width)
        x = x + self.dropout(self.project(mixed))
        refined: Tensor = x + self.dropout(self.feed_forward(x))
        return refined


class TGC(nn.Module):
    """The causal touch-gesture classifier: (B, T, 8, 8) counts to logits at any prefix."""

    def __init__(self, settings: NetworkSettings, classes: int) -> None:
        super().__init__()
        self.settings = settings
        self.stem = FrameStem(settings)
        self.motion = nn.Sequential(
            *(GatedConvolution(settings.width, dilation, settings.dropout) for dilation in settings.dilations)
        )
        self.encoder = nn.Sequential(
            *(
                EncoderBlock(settings.width, settings.heads, settings.feed_forward, settings.dropout)
                for _ in range(settings.blocks)
            )
        )
        self.dense = nn.Sequential(
            nn.LayerNorm(3 * settings.width),
            nn.Dropout(settings.dropout),
            nn.Linear(3 * settings.width, settings.dense),
            nn.GELU(),
            nn.Dropout(settings.dropout),
            nn.Linear(settings.dense, classes),
        )

    def features(self, counts: Tensor) -> Tensor:
        """Return (B, T, width) per-frame features of (B, T, 8, 8) counts; frame t sees frames up to t."""
        features: Tensor = self.encoder(self.motion(self.stem(counts)))
        return features

    def forward(self, counts: Tensor) -> Tensor:
        """Return (B, classes) logits over the whole window (B, T, 8, 8)."""
        features = self.features(counts)
        mean = features.mean(dim=1)
        # Not as a difference of means: in float32 its digits cancel where frames hardly change.
        variance = (features - mean[:, None]).square().mean(dim=1)
        logits: Tensor = self.dense(self.summary(mean, variance, features.amax(dim=1)))
        return logits

    def at_lengths(self, counts: Tensor, lengths: Tensor) -> Tensor:
        """Return (B, K, classes) logits, each over the first frames, as many as `lengths` says, in one pass.

        lengths: (B, K), of each window its own, or (1, K).
        """
        # Sums over a touch need float32, also where the layers train in bfloat16.
        return self.answers(self.features(counts).to(counts.dtype), lengths)

    def answers(self, features: Tensor, lengths: Tensor) -> Tensor:
        """Return what `at_lengths` does, from the features (B, T, width) of the frames."""
        frames = torch.arange(1, features.shape[1] + 1, device=features.device)[:, None]
        mean = features.cumsum(dim=1) / frames
        variance = (features * features).cumsum(dim=1) / frames - mean * mean
        highest = features.cummax(dim=1).values
        last = (lengths - 1)[:, :, None].expand(len(features), -1, features.shape[2])
        ends = [x.gather(1, last) for x in (mean, variance, highest)]
        logits: Tensor = self.dense(self.summary(*ends))
        return logits

    @staticmethod
    def summary(mean: Tensor, variance: Tensor, highest: Tensor) -> Tensor:
        """Return (..., 3 * width), what the dense layers see, of (..., width) each."""
        deviation = torch.sqrt(variance.clamp_min(VARIANCE_FLOOR))
        moments = torch.cat([mean, deviation], dim=-1).to(highest.dtype)
        return torch.cat([moments, highest], dim=-1)


def _convolve(images: Tensor, weight: Tensor, bias: Tensor | None) -> Tensor:
    """Return (B, channels, H, W): (B, ..., H, W) convolved with 3x3 weights, with zeros around the images."""
    if not images.is_cuda:
        return functional.conv2d(images, weight, bias, padding=1)
    # Of networks that train side by side, one product with a large matrix is faster than many convolutions.
    height, width = images.shape[-2:]
    taps = torch.eye(9, device=images.device).reshape(9, 1, 3, 3)
    pixels = torch.eye(height * width, device=images.device).reshape(-1, 1, height, width)
    reached = functional.conv2d(pixels, taps, padding=1).flatten(2)  # (from, 9, to)
    matrix = torch.einsum("oik,fkt->ifot", weight.flatten(2), reached).flatten(2).flatten(0, 1)
    convolved = (images.flatten(1) @ matrix).reshape(len(images), -1, height, width)
    return convolved if bias is None else convolved + bias[:, None, None]


def _at(frames: Tensor, T: int, taps: Tensor) -> Tensor:
    """Return (B, T, taps, ...): for each of T frames in a row, those at the taps after it."""
    return frames[:, torch.arange(T, device=frames.device)[:, None] + taps]


def _planes(smooth_frames: int) -> Tensor:
    """Return (planes, frames): what the first convolution sees of a taxel's last levels, the newest last.

    They are its level and the change since the frame before; with smooth_frames, also the mean over
    that many frames and its change since the mean before.
    """
    spans = (1, smooth_frames) if smooth_frames else (1,)
    weights = []
    for span in spans:
        now = torch.zeros(2 * spans[-1])
        now[-span:] = 1.0 / span
        weights += [now / LEVEL_SPREAD, (now - now.roll(-span)) / CHANGE_SPREAD]
    return torch.stack(weights)
