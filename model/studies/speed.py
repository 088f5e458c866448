"""Size and speed of one answer, ours against the paper's TGC: `python -m touchd.model.studies speed`.

Shares are of processor time, each network on one thread. The paper's networks have random weights, which
takes the same time. Needs the extra `train`.
"""

import sys
import tempfile
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import msgspec
from rich.console import Console
from rich.table import Table

from touchd.model.adapt.threads import one_torch_thread
from touchd.model.classifier import SHIPPED_MODEL, Classifier
from touchd.model.settings import LENGTHS
from touchd.model.studies.checks.hard_cases import hand
from touchd.model.studies.checks.timing import Timing, time_in_turn
from touchd.model.studies.folders import study_parser
from touchd.model.studies.report.front import ONNX_RUNTIME, PYTORCH, answers_of
from touchd.model.studies.report.networks import OURS, TimedNetwork, papers
from touchd.model.studies.report.paper_tgc import PaperSettings

PAPER = (PaperSettings("printed"), PaperSettings("public"))
ANSWERS = 200
BY_STATE = "ONNX Runtime, next frame"
# Of the paper's time for an answer, in each runtime; of our own whole window's, by the state.
ALLOWED_SHARE = {ONNX_RUNTIME: 1 / 10, PYTORCH: 1 / 25, BY_STATE: 1 / 6}


@dataclass(frozen=True)
class Speed:
    """How long one answer takes.

    share: our processor time over the same window as a share of it; by the state, its share of that.
    """

    network: str
    runtime: str
    frames: int
    file_bytes: int
    timing: Timing
    share: float | None = None


def main(arguments: Sequence[str]) -> int:
    """Time the answers and show the table; returns 0."""
    parser = study_parser("speed", "Times one answer.")
    parser.add_argument("--model", type=Path, default=SHIPPED_MODEL, help="an ONNX file; ours without it")
    parser.add_argument("--answers", type=int, default=ANSWERS, help="answers timed of each (%(default)s)")
    parser.add_argument("--json", action="store_true", help="one JSON object instead of a table")
    options = parser.parse_args(arguments)
    speeds = run(options.model, options.answers)
    if options.json:
        sys.stdout.buffer.write(msgspec.json.encode({"speeds": speeds}) + b"\n")
    else:
        Console().print(table(speeds))
    return 0


def run(
    model: Path = SHIPPED_MODEL, answers: int = ANSWERS, paper: Sequence[PaperSettings] = PAPER
) -> list[Speed]:
    """Time the model file at each answered length and the paper's networks; raises ModelError."""
    lengths = tuple(sorted(LENGTHS, reverse=True))
    networks = [TimedNetwork(model.stem, OURS, "float32", lengths, model, 0, 0)]
    with tempfile.TemporaryDirectory() as folder, one_torch_thread():
        for settings in paper:
            networks += [each for each in papers(settings, Path(folder)) if each.eager is not None]
        asked = [(network, *each) for network in networks for each in answers_of(network)]
        asked.insert(1, (networks[0], lengths[0], BY_STATE, next_frame(model, lengths[0])))
        timings = time_in_turn([answer for *_, answer in asked], answers)
        speeds = [
            Speed(network.name, runtime, frames, network.path.stat().st_size, timing)
            for (network, frames, runtime, _), timing in zip(asked, timings, strict=True)
        ]
    return with_shares(speeds)


def next_frame(model: Path, frames: int) -> Callable[[], object]:
    """Return what answers over so many frames by the state that all but the last left."""
    classifier, counts = Classifier.load(model), hand(frames)
    _, state = classifier.step(counts[:-1])
    return partial(classifier.step, counts[-1:], state)


def with_shares(speeds: Sequence[Speed]) -> list[Speed]:
    """Return the speeds with their shares, but for the first network's whole windows."""
    whole = [each for each in speeds if (each.network, each.runtime) == (speeds[0].network, ONNX_RUNTIME)]
    ours = {each.frames: each.timing.processor_ms for each in whole}

    def share(each: Speed) -> float | None:
        if each in whole:
            return None
        theirs_ms, ours_ms = each.timing.processor_ms, ours[each.frames]
        return theirs_ms / ours_ms if each.runtime == BY_STATE else ours_ms / theirs_ms

    return [replace(each, share=share(each)) for each in speeds]


def table(speeds: Sequence[Speed]) -> Table:
    """Return the times as a table for the terminal, with our share of each of the paper's."""
    shown = Table(title="One answer on one thread, asked in turn", caption="The paper's weights are random.")
    for heading in ("network", "runtime"):
        shown.add_column(heading, overflow="fold")
    for heading in ("frames", "file MB", "p50 ms", "p99 ms", "processor ms"):
        shown.add_column(heading, justify="right", overflow="fold")
    for heading in ("ours takes", "allowed"):
        shown.add_column(heading, justify="right")
    for each in speeds:
        share = (f"1/{1 / each.share:.1f}", f"1/{1 / ALLOWED_SHARE[each.runtime]:.0f}") if each.share else ()
        times = (each.timing.p50_ms, each.timing.p99_ms, each.timing.processor_ms)
        size = f"{each.file_bytes / 1e6:.2f}"
        shown.add_row(
            each.network, each.runtime, str(each.frames), size, *(f"{ms:.2f}" for ms in times), *share
        )
    return shown
