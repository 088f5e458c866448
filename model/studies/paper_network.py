"""The paper's touch-gesture classifier (TGC): Ren, Hou and Belpaeme, HRI 2023 Companion.

"printed" is the network of the paper's text and figure 1: Transformer encoder blocks at the defaults of
Vaswani et al. 2017 (512 wide, 8 heads, 2048 inner, post-norm, dropout 0.1), then linear layers without
activations between them. "public" is that of its code (github.com/Yuanbo2020/TGC, context_model.py): blocks
without a feed-forward part and dropout, batch normalisation with the frame index as channel, and ReLU after
each linear layer. Neither encodes a frame's position, except in the flattened output; so a network answers at
one window length only.
"""

import math
from dataclasses import dataclass
from typing import Literal, TypeAlias

import torch
from torch import Tensor, nn

from touchd.drivers.frame import COLUMNS, ROWS

Variant: TypeAlias = Literal["public", "printed"]
DENSE_WIDTHS = (128, 16, 4)


@dataclass(frozen=True)
class PaperSettings:
    """The shape of the paper's network. frames: the window length at which it answers."""

    variant: Variant
    frames: int = 144
    blocks: int = 6
    width: int = 512
    heads: int = 8
    inner: int = 2048
    dropout: float = 0.1
    """In the printed variant only."""


class Attention(nn.Module):
    """Multi-head self-attention with Add & Norm: (B, L, width) to the same; over all frames."""

    def __init__(self, width: int, heads: int, dropout: float) -> None:
        super().__init__()
        self.heads = heads
        self.query = nn.Linear(width, width)
        self.key = nn.Linear(width, width)
        self.value = nn.Linear(width, width)
        self.project = nn.Linear(width, width)
        self.dropout = nn.Dropout(dropout)
        self.norm = nn.LayerNorm(width)

    def forward(self, x: Tensor) -> Tensor:
        """Return (B, L, width)."""
        B, L, width = x.shape
        query, key, value = (
            layer(x).reshape(B, L, self.heads, width // self.heads).transpose(1, 2)
            for layer in (self.query, self.key, self.value)
        )  # each (B, heads, L, width / heads)
        scores = query @ key.transpose(-1, -2) / math.sqrt(width // self.heads)  # (B, heads, L, L)
        mixed = (torch.softmax(scores, dim=-1) @ value).transpose(1, 2).reshape(B, L, width)
        added: Tensor = self.norm(x + self.dropout(self.project(mixed)))
        return added


class FeedForward(nn.Module):
    """The position-wise feed-forward part with Add & Norm: (B, L, width) to the same."""

    def __init__(self, width: int, inner: int, dropout: float) -> None:
        super().__init__()
        self.layers = nn.Sequential(
            nn.Linear(width, inner), nn.ReLU(), nn.Linear(inner, width), nn.Dropout(dropout)
        )
        self.norm = nn.LayerNorm(width)

    def forward(self, x: Tensor) -> Tensor:
        """Return (B, L, width)."""
        added: Tensor = self.norm(x + self.layers(x))
        return added


class PaperTGC(nn.Module):
    """The paper's network: (B, frames, 8, 8) counts to (B, classes) logits."""

    def __init__(self, settings: PaperSettings, classes: int) -> None:
        super().__init__()
        self.settings = settings
        public = settings.variant == "public"
        width, dropout = settings.width, 0.0 if public else settings.dropout
        self.input_norm = nn.BatchNorm2d(settings.frames) if public else nn.Identity()
        self.embed = nn.Linear(ROWS * COLUMNS, width)
        self.encoder = nn.Sequential()
        for _ in range(settings.blocks):
            self.encoder.append(Attention(width, settings.heads, dropout))
            if not public:
                self.encoder.append(FeedForward(width, settings.inner, dropout))
        self.dense = nn.Sequential()
        for before, after in zip((width, *DENSE_WIDTHS), DENSE_WIDTHS, strict=False):
            self.dense.append(nn.Linear(before, after))
            if public:
                self.dense.append(nn.ReLU())
        self.classify = nn.Linear(settings.frames * DENSE_WIDTHS[-1], classes)

    def features(self, counts: Tensor) -> Tensor:
        """Return (B, frames * 4), the input of the last layer."""
        frames = self.input_norm(counts).flatten(2)  # (B, frames, 64)
        flattened: Tensor = self.dense(self.encoder(self.embed(frames))).flatten(1)
        return flattened

    def forward(self, counts: Tensor) -> Tensor:
        """Return (B, classes) logits."""
        logits: Tensor = self.classify(self.features(counts))
        return logits
