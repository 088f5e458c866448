"""Runs the network on a few frames of a touch at a time, with an explicit state, as in the model file."""

import math
from typing import NamedTuple, TypeVar

import torch
from torch import Tensor, nn

from touchd.drivers.frame import COLUMNS, ROWS
from touchd.model.tgc import TGC, EncoderBlock, GatedConvolution

Layer = TypeVar("Layer", bound=nn.Module)

# Attention drops a frame once even the flattest slope, 2^-8 a frame, gives it less than this share of the
# newest frame's weight.
FORGOTTEN_WEIGHT = 1e-8
MEMORY_FRAMES = math.ceil(-math.log(FORGOTTEN_WEIGHT) * 2**8)


class TGCState(NamedTuple):
    """The network's state after some frames; its size is bounded.

    B is the batch size; a state of one touch, such as the initial one, may precede a batch of windows.
    level: (B, past, 8, 8) levels of the last frames that the stem sees. motion: (B, past, width) last
    inputs of the gated convolutions, concatenated. memory: keys and values of each encoder block,
    (B, 2 * heads, M, width / heads), M at most MEMORY_FRAMES. sums: (B, 2 * width) float64, of each
    feature and of its square. highest: (B, width), each feature's maximum. frames: (1,) int64, their
    number.
    """

    level: Tensor
    motion: Tensor
    memory: tuple[Tensor, ...]
    sums: Tensor
    highest: Tensor
    frames: Tensor


def initial_state(network: TGC) -> TGCState:
    """Return the state before the first frame."""
    width, heads = network.settings.width, network.settings.heads
    past = sum(layer.past for layer in _layers(network.motion, GatedConvolution))
    memory = torch.zeros(1, 2 * heads, 0, width // heads)
    return TGCState(
        level=torch.zeros(1, network.stem.past, ROWS, COLUMNS),
        motion=torch.zeros(1, past, width),
        memory=(memory,) * network.settings.blocks,
        sums=torch.zeros(1, 2 * width, dtype=torch.float64),
        highest=torch.full((1, width), torch.finfo(torch.float32).min),
        frames=torch.zeros(1, dtype=torch.int64),
    )


def step(network: TGC, counts: Tensor, state: TGCState) -> tuple[Tensor, TGCState]:
    """Return (B, classes) logits over all frames so far, and the state after these (B, T, 8, 8) counts."""
    levels = network.stem.level(counts)
    last = torch.where(state.frames > 0, state.level, levels[:, :1])
    x = network.stem.embed_level(levels, last)
    pasts = []
    layers = _layers(network.motion, GatedConvolution)
    motion = torch.split(state.motion.expand(x.shape[0], -1, -1), [layer.past for layer in layers], dim=1)
    for layer, past in zip(layers, motion, strict=True):
        padded = torch.cat([past, x], dim=1)
        pasts.append(padded[:, -layer.past :])
        x = layer.follow(x, padded)
    memories = []
    for block, memory in zip(_layers(network.encoder, EncoderBlock), state.memory, strict=True):
        query, new = block.project_in(x)
        key_value = torch.cat([memory.expand(x.shape[0], -1, -1, -1), new], dim=2)
        x = block.attend(x, query, key_value)
        memories.append(key_value[:, :, -MEMORY_FRAMES:])
    # In float64, a frame still changes the sums after hours, and their variance is exact enough.
    exact = x.double()
    sums = state.sums + torch.cat([exact, exact * exact], dim=-1).sum(dim=1)
    highest = torch.maximum(state.highest, x.amax(dim=1))
    frames = state.frames + x.shape[1]
    mean, squares = (sums / frames.double()).chunk(2, dim=-1)
    logits: Tensor = network.dense(network.summary(mean, squares - mean * mean, highest))
    seen = torch.cat([last, levels], dim=1)[:, -network.stem.past :]
    return logits, TGCState(seen, torch.cat(pasts, dim=1), tuple(memories), sums, highest, frames)


def _layers(modules: nn.Sequential, kind: type[Layer]) -> list[Layer]:
    return [module for module in modules if isinstance(module, kind)]
