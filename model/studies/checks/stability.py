"""Numerical stability of a model file, case by case.

Probabilities must be finite, sum to 1, agree with the same network in float64, and depend only on their
frames: not on the batch, later frames, threads, the counts' type, chance or how many frames come at a time.
"""

from __future__ import annotations

import tempfile
from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from importlib.util import find_spec
from itertools import cycle
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from rich.box import SIMPLE_HEAD
from rich.table import Table

from touchd.model.classifier import SHIPPED_MODEL, Classifier, ModelInputError
from touchd.model.studies.checks.hard_cases import FRAMES, checkerboard, hand, hard_cases, tiny
from touchd.model.studies.checks.timing import time_in_turn
from touchd.model.studies.hand import simulate

if TYPE_CHECKING:
    from touchd.model.studies.checks.reference import Reference

EXTREME_FACTORS = (1e4, -1e4, 1e30, -1e30)
TIMED_ANSWERS = 60
REPEATS = 3
EMPTY = "Empty: does not apply, or needs the extra `train` and the checkpoint beside the model."
TITLE = "Worst deviation seen; what is allowed is in the heading"
LATER_FRAMES = 54
CHUNKS = (1, 2, 5, 1, 9, 27, 1)
"""Frames that come at a time, over and over."""
SAMPLED_FRAMES = 18
GESTURES = ("stroke", "pat", "constant", "tickle", "rub", "scratch")
SEED = 1

SUMS_TO_1 = "sums to 1"
FLOAT64 = "float64"
BATCH = "batch"
LATER = "later frames"
CHUNKED = "in chunks"
THREADS = "2 threads"
REPEATED = "repeated"
TYPES = "uint16"
REFUSED = "refused"
SLOWDOWN = "slowdown"
TOLERANCES = {
    SUMS_TO_1: 1e-6,
    FLOAT64: 1e-4,
    BATCH: 1e-6,
    LATER: 1e-6,
    CHUNKED: 1e-5,
    THREADS: 1e-6,
    REPEATED: 0.0,
    TYPES: 0.0,
    REFUSED: 0.0,
    SLOWDOWN: 1.5,
}


@dataclass(frozen=True)
class CaseResult:
    """One property in one case: the worst deviation seen, and what is allowed.

    Deviations are of probabilities (of logits for "later frames"), infinite where an answer is not finite;
    "refused" counts the windows that were answered; "slowdown" is a ratio of median times.
    """

    case: str
    measure: str
    worst: float
    tolerance: float
    passed: bool


def run(model: Path = SHIPPED_MODEL, hours: float = 0.0) -> list[CaseResult]:
    """Check a model file in every case; raises ModelError when it cannot be loaded.

    hours: of one unbroken stream to check too, 2 minutes each.

    Checks that need the extra `train`, or the checkpoint beside the file (.pt), are left out without it. A
    damaged checkpoint raises CheckpointError.
    """
    classifier = Classifier.load(model)
    two_threads = Classifier.load(model, threads=2)
    reference, weights = None, model.with_suffix(".pt")
    if has_train_extra() and weights.exists():
        from touchd.model.studies.checks.reference import Reference

        reference = Reference.load(weights, classifier.metadata)
    checks: list[CaseResult] = []
    for case in hard_cases(classifier.metadata.max_length):
        seen = [_deviations(window, classifier, two_threads, reference) for window in case.windows]
        checks += [
            _judge(case.name, measure, [each[measure] for each in seen if measure in each])
            for measure in dict.fromkeys(measure for each in seen for measure in each)
        ]
    checks.append(_check_refusals(classifier))
    checks.append(_judge("tiny values", SLOWDOWN, [slowdown(classifier, tiny(), hand(FRAMES))]))
    if hours and reference is not None:
        streamed = list(stream(classifier, reference, round(60 * hours)))
        checks.append(_judge(f"{hours:g} hours of touches", CHUNKED, streamed))
    if has_train_extra():
        checks.append(_check_extreme_logits(model))
    return checks


def has_train_extra() -> bool:
    """Whether PyTorch and onnx are installed, which comparing with float64 and extreme logits need."""
    return all(find_spec(name) for name in ("torch", "onnx"))


def chunked(
    classifier: Classifier, window: NDArray[np.float32], sizes: Sequence[int], every: int = 1
) -> float:
    """Return how far answers to a few frames at a time are from those to whole windows.

    sizes: how many frames come at a time, over and over.
    """
    furthest, stop, state = 0.0, 0, None
    for size in cycle(sizes):
        start, stop = stop, min(stop + size, len(window))
        answer, state = classifier.step(window[start:stop], state)
        if stop // every > start // every or stop == len(window):
            furthest = max(furthest, _distance(answer, classifier.probabilities(window[:stop])))
        if stop == len(window):
            break
    return furthest


def stream(classifier: Classifier, reference: Reference, minutes: int) -> Iterator[float]:
    """Stream one long touch of all gestures; yield its deviation from float64 after each minute."""
    from touchd.model.adapt.threads import one_torch_thread

    script = [(gesture, 60 / len(GESTURES)) for gesture in GESTURES]
    state, exact_state = None, reference.initial_state()
    for minute in range(minutes):
        counts = np.concatenate([part.counts for part in simulate(script, SEED + minute)])
        # Odd pieces first, so that chunks begin anywhere.
        for chunk in np.split(counts.astype(np.float32), [*np.cumsum(CHUNKS), *range(400, len(counts), 400)]):
            answer, state = classifier.step(chunk, state)
            # On a busy machine, threads that wait for one another take seven times as long as one.
            with one_torch_thread():
                expected, exact_state = reference.step(chunk, exact_state)
        yield _distance(answer, expected)


def slowdown(classifier: Classifier, window: NDArray[np.float32], usual: NDArray[np.float32]) -> float:
    """Return how many times longer an answer takes on `window` than on `usual`, in processor time."""
    asked = [partial(classifier.probabilities, each) for each in (window, usual)]
    slow, normal = time_in_turn(asked, TIMED_ANSWERS)
    return slow.processor_ms / normal.processor_ms


def table(checks: Sequence[CaseResult]) -> Table:
    """Return the checks as a table for the terminal: a case a row, a property a column."""
    shown = Table(title=TITLE, caption=EMPTY, box=SIMPLE_HEAD, padding=(0, 1, 0, 0), pad_edge=False)
    shown.add_column("case", min_width=16)
    for measure, tolerance in TOLERANCES.items():
        shown.add_column(f"{measure}\n≤{tolerance:.2g}", justify="right", overflow="fold")
    cells = {(check.case, check.measure): check for check in checks}
    for case in dict.fromkeys(check.case for check in checks):
        shown.add_row(case, *(_cell(cells.get((case, measure))) for measure in TOLERANCES))
    return shown


def _deviations(
    window: NDArray[np.float32], classifier: Classifier, two_threads: Classifier, reference: Reference | None
) -> dict[str, float]:
    answer = classifier.probabilities(window)
    others = np.stack([hand(len(window)), window, checkerboard(len(window))])
    again = [classifier.probabilities(window) for _ in range(REPEATS)]
    deviations = {
        SUMS_TO_1: _off_one(answer),
        BATCH: _distance(answer, classifier.batch_probabilities(others)[1]),
        CHUNKED: max(chunked(classifier, window, sizes, SAMPLED_FRAMES) for sizes in (CHUNKS, (1,))),
        THREADS: _distance(answer, two_threads.probabilities(window)),
        REPEATED: max(_distance(answer, repeat) for repeat in again),
    }
    if np.array_equal(window, np.rint(window)):
        deviations[TYPES] = _distance(answer, classifier.probabilities(window.astype(np.uint16)))
    if reference is not None:
        deviations[FLOAT64] = _distance(answer, reference.probabilities(window))
        longer = np.concatenate([window, checkerboard(LATER_FRAMES)])
        deviations[LATER] = _distance(reference.logits(window), reference.logits_at(longer, len(window)))
    return deviations


def _check_refusals(classifier: Classifier) -> CaseResult:
    answered = 0.0
    for bad in (np.nan, np.inf, -np.inf, -1.0, 1024.0):
        window = hand(FRAMES)
        window[-1, -1, -1] = bad
        with suppress(ModelInputError):
            classifier.probabilities(window)
            answered += 1
    return _judge("NaN, infinite, negative, > 1023", REFUSED, [answered])


def _check_extreme_logits(model: Path) -> CaseResult:
    """Check copies of the file with multiplied logits, which make the softmax as steep as possible."""
    from touchd.model.studies.checks.reference import scale_logits

    deviations: list[float] = []
    with tempfile.TemporaryDirectory() as folder:
        for factor in EXTREME_FACTORS:
            copy = Path(folder) / "extreme.onnx"
            scale_logits(model, factor, copy)
            extreme = Classifier.load(copy)
            deviations += [_off_one(extreme.probabilities(w)) for w in (hand(FRAMES), checkerboard(FRAMES))]
    return _judge("extreme logits", SUMS_TO_1, deviations)


def _judge(case: str, measure: str, deviations: Sequence[float]) -> CaseResult:
    worst = max(deviations)
    return CaseResult(case, measure, worst, TOLERANCES[measure], worst <= TOLERANCES[measure])


def _off_one(probabilities: NDArray[np.float64]) -> float:
    if not np.isfinite(probabilities).all() or probabilities.min() < 0:
        return float("inf")
    return abs(float(probabilities.sum()) - 1.0)


def _distance(one: NDArray[np.float64], other: NDArray[np.float64]) -> float:
    distance = float(np.abs(one - other).max())
    return distance if np.isfinite(distance) else float("inf")


def _cell(check: CaseResult | None) -> str:
    if check is None:
        return ""
    worst = f"{check.worst:.0e}" if 0 < check.worst < 1e-2 else f"{check.worst:.2g}"
    return f"[green]{worst}[/]" if check.passed else f"[bold red]{worst} FAILS[/]"
