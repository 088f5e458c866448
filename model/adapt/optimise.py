"""What all trainings share: the learning rate of a step, the limit of a gradient, the threads of PyTorch."""

import math
from collections.abc import Iterator
from contextlib import contextmanager

import torch

GRADIENT_LIMIT = 1.0


def learning_rate_at(step: int, steps: int, peak: float) -> float:
    """One-cycle schedule: linear warm-up over the first tenth, then cosine decay to zero (Smith 2018)."""
    rise = max(1, steps // 10)
    if step < rise:
        return peak * (step + 1) / rise
    return 0.5 * peak * (1.0 + math.cos(math.pi * (step - rise) / max(1, steps - rise)))


@contextmanager
def one_torch_thread() -> Iterator[None]:
    """Make PyTorch compute on one thread inside this context."""
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        yield
    finally:
        torch.set_num_threads(before)
