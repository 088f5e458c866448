"""The learning-rate schedule that all trainings share."""

import math

GRADIENT_LIMIT = 1.0


def learning_rate_at(step: int, steps: int, peak: float) -> float:
    """One-cycle schedule: linear warm-up over the first tenth, then cosine decay to zero (Smith 2018)."""
    rise = max(1, steps // 10)
    if step < rise:
        return peak * (step + 1) / rise
    return 0.5 * peak * (1.0 + math.cos(math.pi * (step - rise) / max(1, steps - rise)))
