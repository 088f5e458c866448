"""Numerical stability of a model file on hard cases: `python -m touchd.model.studies stability`.

Probabilities must be finite, sum to 1, agree with the same network in float64, and depend only on their
frames: not on the batch, later frames, threads, the counts' type or how many frames come at a time.
"""

from __future__ import annotations

import tempfile
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from importlib.util import find_spec
from itertools import cycle
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from rich.box import SIMPLE_HEAD
from rich.console import Group, JustifyMethod
from rich.table import Table

from touchd.model.classifier import SHIPPED_MODEL, Classifier, load_own
from touchd.model.studies.checks.hard_cases import FRAMES, checkerboard, hand, hard_cases, tiny
from touchd.model.studies.checks.timing import time_interleaved
from touchd.model.studies.simulated import simulate

if TYPE_CHECKING:
    from touchd.model.studies.checks.reference import Reference

EXTREME_FACTORS = (1e4, -1e4, 1e30, -1e30)
TIMED_ANSWERS = 60
REPEATS = 3
NOT_CHECKED = "not checked: needs the extra `train` and the checkpoint"
LATER_FRAMES = 54
CHUNKS = (1, 2, 5, 1, 9, 27, 1)
"""Sizes of the chunks that frames arrive in, repeated."""
SAMPLED_FRAMES = 18
GESTURES = ("stroke", "pat", "constant", "tickle", "rub", "scratch")
SEED = 1

SUMS_TO_1 = "sums to 1"
FLOAT64 = "equals float64"
BATCH = "same in a batch"
LATER = "ignores later frames"
CHUNKED = "same in chunks"
THREADS = "same on 2 threads"
REPEATED = "same again"
TYPES = "same for uint16"
REFUSED = "refuses bad input"
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
COLUMNS: Mapping[str, JustifyMethod] = MappingProxyType(
    {"property": "left", "allowed": "right", "worst": "right", "in the case": "left"}
)


@dataclass(frozen=True)
class CaseResult:
    """One property in one case: the worst deviation seen, and what is allowed.

    Deviations are of probabilities (of logits for LATER), infinite where an answer is not finite.
    REFUSED counts the bad windows that were answered; SLOWDOWN is a ratio of median times.
    """

    case: str
    measure: str
    worst: float
    tolerance: float
    passed: bool


def run(model: Path = SHIPPED_MODEL, hours: float = 0.0) -> list[CaseResult]:
    """Check a model file in every case; raises ModelError when it cannot be loaded.

    hours: length of an unbroken stream to check as well; an hour takes 2 minutes.

    Checks that need the extra `train`, or the checkpoint beside the file (.pt), are skipped without it. A
    damaged checkpoint raises CheckpointError.
    """
    classifier = load_own(model)
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
    """Return the largest deviation of answers to chunks of frames from those to whole windows.

    sizes: of the chunks, repeated. every: frames between comparisons.
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
    from touchd.model.adapt.head import one_torch_thread

    script = [(gesture, 60 / len(GESTURES)) for gesture in GESTURES]
    state, exact_state = None, reference.initial_state()
    for minute in range(minutes):
        counts = np.concatenate([part.counts for part in simulate(script, SEED + minute)])
        # Pieces of various sizes first, so that chunks begin at any frame.
        for chunk in np.split(counts.astype(np.float32), [*np.cumsum(CHUNKS), *range(400, len(counts), 400)]):
            answer, state = classifier.step(chunk, state)
            # On a busy machine several threads wait for each other and take seven times as long as one.
            with one_torch_thread():
                expected, exact_state = reference.step(chunk, exact_state)
        yield _distance(answer, expected)


def slowdown(classifier: Classifier, window: NDArray[np.float32], usual: NDArray[np.float32]) -> float:
    """Return the processor time of an answer on `window` as a multiple of that on `usual`."""
    asked = [partial(classifier.probabilities, each) for each in (window, usual)]
    slow, normal = time_interleaved(asked, TIMED_ANSWERS)
    return slow / normal


def table(checks: Sequence[CaseResult]) -> Group:
    """Return a table for the terminal, with a row per property and its worst case, and a summary below."""
    shown = Table(box=SIMPLE_HEAD, padding=(0, 1, 0, 0), pad_edge=False)
    for heading, justify in COLUMNS.items():
        shown.add_column(heading, justify=justify)
    for measure, tolerance in TOLERANCES.items():
        own = [check for check in checks if check.measure == measure]
        if not own:
            shown.add_row(measure, f"{tolerance:.2g}", "", NOT_CHECKED)
            continue
        worst = max(own, key=lambda check: check.worst)
        colour = "green" if worst.passed else "bold red"
        where = worst.case if worst.worst else f"all {len(own)} cases" if len(own) > 1 else worst.case
        shown.add_row(measure, f"{tolerance:.2g}", f"[{colour}]{worst.worst:.2g}[/]", where)
    return Group(shown, sentence(checks))


def sentence(checks: Sequence[CaseResult]) -> str:
    """Return a sentence that sums up all checks."""
    failed = [check for check in checks if not check.passed]
    if not failed:
        return f"All {len(checks)} checks passed: no window of counts breaks this file's arithmetic."
    names = "; ".join(f"{check.measure} ({check.case})" for check in failed)
    return f"{len(failed)} of {len(checks)} checks FAILED, so do not use this file: {names}."


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
        with suppress(ValueError):
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
