"""The shipped model's arithmetic on extreme windows."""

import io
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rich.console import Console

from touchd.model.classifier import SHIPPED_MODEL, Classifier, ModelError
from touchd.model.studies.checks import stability
from touchd.model.studies.checks.hard_cases import hand
from touchd.model.studies.checks.stability import FLOAT64, LATER, TOLERANCES, CaseResult

# Every case runs in both runtimes.
pytestmark = pytest.mark.timeout(300)


@pytest.fixture(scope="module")
def checks() -> list[CaseResult]:
    return stability.run(SHIPPED_MODEL)


@pytest.mark.slow
@pytest.mark.parametrize("measure", TOLERANCES)
def test_the_shipped_model_holds_in_every_case(checks: list[CaseResult], measure: str) -> None:
    measured = [check for check in checks if check.measure == measure]
    if not measured and measure in (FLOAT64, LATER):
        pytest.skip(f"{measure} needs the extra `train` and the shipped checkpoint")
    assert measured
    assert [check for check in measured if not check.passed] == []


def test_a_model_whose_logits_overflow_is_refused(tmp_path: Path) -> None:
    pytest.importorskip("onnx", reason="needs the extra `train`")
    from touchd.model.studies.checks.reference import scale_logits

    broken = tmp_path / "broken.onnx"
    scale_logits(SHIPPED_MODEL, 3e38, broken)
    with pytest.raises(ModelError, match="not probabilities"):
        stability.run(broken)


def test_a_failed_check_is_named_in_the_last_sentence() -> None:
    passed = [CaseResult("a hand", measure, 1e-7, 1e-6, passed=True) for measure in TOLERANCES]
    failed = CaseResult("a hand", "sums to 1", math.inf, 1e-6, passed=False)
    lines = render([*passed, failed]).splitlines()
    assert lines[-1].endswith("so do not use this file: sums to 1 (a hand).")
    assert render(passed).splitlines()[-1].startswith(f"All {len(passed)} checks passed")
    assert "inf" in next(line for line in lines if line.strip().startswith("sums to 1"))


def render(checks: list[CaseResult]) -> str:
    console = Console(width=80, file=io.StringIO(), record=True)
    console.print(stability.table(checks))
    return console.export_text().rstrip()


@pytest.fixture(scope="module")
def exact(classifier: Classifier) -> Any:
    """The shipped network in float64."""
    pytest.importorskip("torch", reason="needs the extra `train`")
    from touchd.model.studies.checks.reference import Reference

    return Reference.load(SHIPPED_MODEL.with_suffix(".pt"), classifier.metadata)


def test_an_answer_does_not_drift_over_hundreds_of_hours(classifier: Classifier, exact: Any) -> None:
    import torch

    _, state = classifier.step(hand(400))
    _, exact_state = exact.step(hand(400), exact.initial_state())
    for times in (1, 1_000, 3_000, 30_000, 100_000):
        # The state after these frames repeated `times` times.
        older = {"sums": state["sums"] * times, "frames": state["frames"] * times}
        answer, _ = classifier.step(hand(9), {**state, **older})
        sums, frames = (torch.from_numpy(older[name]) for name in ("sums", "frames"))
        expected, _ = exact.step(hand(9), exact_state._replace(sums=sums, frames=frames))
        assert np.abs(answer - expected).max() <= TOLERANCES[stability.BATCH]


@pytest.mark.slow
@pytest.mark.timeout(1800)
def test_three_hours_of_touches_stay_as_in_float64(classifier: Classifier, exact: Any) -> None:
    assert max(stability.stream(classifier, exact, minutes=180)) <= TOLERANCES[stability.CHUNKED]


def test_a_state_keeps_no_more_than_attention_remembers(classifier: Classifier) -> None:
    pytest.importorskip("torch", reason="needs the extra `train`")
    from touchd.model.training.stepwise import MEMORY_FRAMES

    state, sizes = None, []
    for _ in range(14):
        _, state = classifier.step(hand(400), state)
        sizes.append(state["memory0"].shape[2])
    assert sizes[:2] == [400, 800]
    assert sizes[-2:] == [MEMORY_FRAMES, MEMORY_FRAMES]
