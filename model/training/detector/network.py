"""The detector's network: two small convolutions over the pad, and a memory over time."""

import torch
from torch import Tensor, nn
from torch.nn import functional

from touchd.drivers.frame import COLUMNS, ROWS
from touchd.model.training.detector.signals import CHANNELS, TOTALS, Pad, follow, inputs


class DetectorNetwork(nn.Module):
    """Maps `signals.inputs` to the probability that a hand is on the pad in a frame; 11 thousand weights."""

    def __init__(self, first: int = 12, second: int = 24, memory: int = 32) -> None:
        super().__init__()
        self.near = nn.Conv2d(CHANNELS, first, 3, padding=1)
        self.far = nn.Conv2d(first, second, 3, stride=2, padding=1)
        self.join = nn.Linear(2 * second + TOTALS, memory)
        self.memory = nn.GRU(memory, memory, batch_first=True)
        self.out = nn.Linear(2 * memory, 1)

    def see(self, taxels: Tensor, totals: Tensor) -> Tensor:
        """Return (N, memory) features of N frames: taxels (N, 4, 64), totals (N, 2)."""
        x = torch.relu(self.near(taxels.reshape(-1, CHANNELS, ROWS, COLUMNS)))
        x = torch.relu(self.far(x)).flatten(2)
        return torch.relu(self.join(torch.cat([x.mean(dim=2), x.amax(dim=2), totals], dim=1)))

    def forward(self, taxels: Tensor, totals: Tensor, hidden: Tensor | None = None) -> Tensor:
        """Return (B, T) logits of sequences: taxels (B, T, 4, 64), totals (B, T, 2)."""
        B, T = totals.shape[:2]
        seen = self.see(taxels.flatten(0, 1), totals.flatten(0, 1)).reshape(B, T, -1)
        remembered, _ = self.memory(seen, hidden)
        logits: Tensor = self.out(torch.cat([seen, remembered], dim=2)).squeeze(2)
        return logits

    def remember(self, seen: Tensor, hidden: Tensor) -> Tensor:
        """Return the memory (B, memory) after a frame's features (B, memory): one step of the GRU."""
        seen_weight, hidden_weight, seen_bias, hidden_bias = self.memory.all_weights[0]
        from_seen = functional.linear(seen, seen_weight, seen_bias)
        from_hidden = functional.linear(hidden, hidden_weight, hidden_bias)
        r1, z1, n1 = from_seen.chunk(3, dim=1)
        r2, z2, n2 = from_hidden.chunk(3, dim=1)
        z = torch.sigmoid(z1 + z2)
        new = torch.tanh(n1 + torch.sigmoid(r1 + r2) * n2)
        return new + z * (hidden - new)

    def step(self, counts: Tensor, pad: Pad, hidden: Tensor, is_touch: Tensor) -> tuple[Tensor, Pad, Tensor]:
        """Return the probability (B, 1) for a frame (B, 1, 64), the next state of the pad, and the memory.

        is_touch: (B, 1), 1 during a touch; rest and noise then stay unchanged.
        """
        seen = self.see(*inputs(counts, pad))
        hidden = self.remember(seen, hidden)
        probability = torch.sigmoid(self.out(torch.cat([seen, hidden], dim=1)))
        untouched = (1.0 - is_touch) * (1.0 - probability)
        return probability, follow(counts, pad, untouched[..., None]), hidden
