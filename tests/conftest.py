"""What tests of every folder share."""

from __future__ import annotations

import os
from collections.abc import Iterator

# Several workers share the cores; threads of torch and numpy beyond one only wait for each other.
os.environ.setdefault("OMP_NUM_THREADS", "1")

import pytest

from model.classifier import SHIPPED_MODEL, Classifier


@pytest.fixture(scope="session")
def classifier() -> Classifier:
    """The shipped model."""
    return Classifier.load(SHIPPED_MODEL)


@pytest.fixture(scope="module")
def one_thread() -> Iterator[None]:
    """One thread for torch: sums are then the same on every run."""
    from model.training.threads import one_torch_thread

    with one_torch_thread():
        yield
