"""Laws of cost: how a time grows, fitted by least squares with terms that cannot be negative."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import nnls


@dataclass(frozen=True)
class Law:
    """cost = sum of coefficients[power] * n ** power.

    largest_miss: of the costs it was fitted to, as a share of each.
    """

    coefficients: tuple[float, ...]
    largest_miss: float

    def at(self, n: float) -> float:
        """Return the cost of n."""
        return float(sum(self.parts(n)))

    def parts(self, n: float) -> list[float]:
        """Return what each term adds to the cost of n."""
        return [coefficient * n**power for power, coefficient in enumerate(self.coefficients)]

    def shares(self, n: float) -> list[float]:
        """Return each term's share of the cost of n."""
        return [part / self.at(n) for part in self.parts(n)]


def fit(sizes: Sequence[int], costs: Sequence[float], degree: int) -> Law:
    """Return the law of that degree with the least sum of squared misses, each as a share of its cost.

    As shares, because costs of small and large sizes lie far apart, and each is known to a share of itself.
    """
    n, cost = np.asarray(sizes, dtype=float), np.asarray(costs, dtype=float)
    powers = np.stack([n**power for power in range(degree + 1)], axis=1)
    coefficients, _ = nnls(powers / cost[:, None], np.ones(len(cost)))
    misses = np.abs(powers @ coefficients / cost - 1.0)
    return Law(tuple(float(value) for value in coefficients), float(misses.max()))
