"""Cost, as the page tells it: the laws of growing windows and of more and more pads, and what they mean."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

from docs.studies.report.law import Law, fit
from docs.studies.report.markdown import provenance, table
from docs.studies.report.networks import SHIPPED
from docs.studies.report.results import Results
from drivers.frame import FRAME_RATE_HZ
from model.settings import LENGTHS

NETWORKS: Mapping[str, str] = {
    SHIPPED: "touchd",
    "tgc-public": "the paper's, as its code has it",
    "tgc-printed": "the paper's, as printed",
}
WAYS: Mapping[str, str] = {"single": "one after another", "batched": "in one batch"}
FRAME_MS = 1000.0 / FRAME_RATE_HZ
DAEMON_KEY = "cost/pads/daemon"
DAEMON_TOUCH_S = 4.5
"""How often `touchd bench` touches the pad."""
TOUCH_S = LENGTHS[-1] / FRAME_RATE_HZ


def page(results: Results) -> str:
    """Return the section in Markdown; says so where nothing has been measured."""
    if not measured(results):
        return "Not measured yet: `python -m docs.studies report --only cost`.\n"
    lines = [f"Measured by {provenance(results, 'cost/')}.", "", "![Cost](figures/cost.png)", ""]
    lines += ["### As the window grows", "", *_window_lines(results)]
    lines += ["### As pads are added", "", *_pad_lines(results)]
    return "\n".join(lines)


def measured(results: Results) -> bool:
    """Return whether everything that the section needs has been measured."""
    return bool(results.keys("cost/window/") and results.keys("cost/pads/1/") and results.has(DAEMON_KEY))


def window_times(results: Results, network: str, figure: str = "processor_ms") -> dict[int, float]:
    """Return a network's figure by the frames of its window, shortest first."""
    keys = [key for key in results.keys("cost/window/") if key.endswith(f"/{network}")]
    return dict(sorted((int(key.split("/")[2]), results.get(key)[figure]) for key in keys))


def pad_times(results: Results, way: str, figure: str = "processor_ms") -> dict[int, float]:
    """Return a figure of answering pads in one way, by their number."""
    keys = [key for key in results.keys("cost/pads/") if key.endswith(f"/{way}")]
    return dict(sorted((int(key.split("/")[2]), results.get(key)[figure]) for key in keys))


def window_law(results: Results, network: str, figure: str = "processor_ms") -> Law:
    """Return the law a + b L + c L² of a network's figure."""
    times = window_times(results, network, figure)
    return fit(list(times), list(times.values()), degree=2)


def pad_law(results: Results, way: str) -> Law:
    """Return the law a + b n of the time until the last of n pads is answered."""
    times = pad_times(results, way)
    return fit(list(times), list(times.values()), degree=1)


def _window_lines(results: Results) -> Iterator[str]:
    yield "One answer on one thread in ONNX Runtime, p50 / p99 in ms; all networks and lengths took turns."
    yield ""
    lengths = [str(frames) for frames in window_times(results, SHIPPED)]
    yield from table(("network", *(f"{frames} frames" for frames in lengths)), _window_rows(results))
    yield (
        "The law a + b L + c L² for L frames, fitted to the median processor time by least squares of "
        f"relative misses, and how it splits the time and the multiply-adds over {LENGTHS[-1]} frames:"
    )
    yield ""
    headings = (
        *("network", "a, ms", "b, µs a frame", "c, ns a frame²", "largest miss"),
        *("of the time: a / b L / c L², %", "of the multiply-adds, %", "c L² overtakes b L at"),
    )
    yield from table(headings, _law_rows(results))
    yield from _window_meaning(results)


def _window_rows(results: Results) -> Iterator[list[str]]:
    for network, title in NETWORKS.items():
        p50, p99 = (window_times(results, network, figure).values() for figure in ("p50_ms", "p99_ms"))
        yield [title, *(f"{middle:.2f} / {high:.2f}" for middle, high in zip(p50, p99, strict=True))]


def _law_rows(results: Results) -> Iterator[list[str]]:
    for network, title in NETWORKS.items():
        law, work = window_law(results, network), window_law(results, network, "multiply_adds")
        a, b, c = law.coefficients
        overtakes = f"{b / c:,.0f} frames" if c > 0 else "never"
        row = [title, f"{a:.3f}", f"{1e3 * b:.2f}", f"{1e6 * c:.1f}", f"{law.largest_miss:.0%}"]
        yield [*row, _split(law), _split(work), overtakes]


def _split(law: Law) -> str:
    return " / ".join(f"{100 * share:.0f}" for share in law.shares(LENGTHS[-1]))


def _window_meaning(results: Results) -> Iterator[str]:
    times = window_times(results, SHIPPED)
    law, longest = window_law(results, SHIPPED), max(times)
    fixed, _, squared = law.shares(LENGTHS[-1])
    marks = ", ".join(map(str, LENGTHS))
    yield f"""\
For touchd, {100 * fixed:.0f} % of an answer over {LENGTHS[-1]} frames is spent before the first frame,
{100 * squared:.0f} % on attention between frames, and the rest on each frame by itself. Over {longest}
frames, 8 s, attention takes {100 * law.shares(longest)[2]:.0f} %. The three answers to a touch, over {marks}
frames, take {_answers_ms(results):.1f} ms of the {1000 * TOUCH_S:.0f} ms that they are about.
"""


def _answers_ms(results: Results) -> float:
    """Return what the three answers to a touch take."""
    times = window_times(results, SHIPPED)
    return sum(times[frames] for frames in LENGTHS)


def _pad_lines(results: Results) -> Iterator[str]:
    yield f"""\
n pads whose windows of {LENGTHS[-1]} frames are full at the same moment, answered by one process on one
thread: the time until the last is answered, p50 / p99 in ms, and the median processor time of a batch as a
share of that of single answers. Memory is the most that a fresh process took which does nothing but answer.
"""
    numbers = list(pad_times(results, "single"))
    yield from table(
        ("pads", *(WAYS[way] for way in WAYS), "batch against single", "memory single / batch, MB"),
        (_pad_row(results, n) for n in numbers),
    )
    yield "The law a + b n, fitted as above, and how many such answers fit into the time of one frame:"
    yield ""
    yield from table(
        ("way", "a, ms", "b, ms a pad", "largest miss", f"pads within {FRAME_MS:.1f} ms"), _pad_laws(results)
    )
    yield from _pad_meaning(results, max(numbers))


def _pad_row(results: Results, pads: int) -> list[str]:
    def figures(figure: str) -> list[float]:
        return [pad_times(results, way, figure)[pads] for way in WAYS]

    times = [f"{p50:.2f} / {p99:.2f}" for p50, p99 in zip(figures("p50_ms"), figures("p99_ms"), strict=True)]
    single, batched = figures("processor_ms")
    memory = " / ".join(f"{peak / 1e6:.0f}" for peak in figures("peak_bytes"))
    return [str(pads), *times, f"{batched / single:.0%}", memory]


def _pad_laws(results: Results) -> Iterator[list[str]]:
    for way, title in WAYS.items():
        law = pad_law(results, way)
        a, b = law.coefficients
        yield [title, f"{a:.3f}", f"{b:.3f}", f"{law.largest_miss:.0%}", str(int((FRAME_MS - a) / b))]


def _pad_meaning(results: Results, most: int) -> Iterator[str]:
    daemon = results.get(DAEMON_KEY)
    answers_ms, core = _answers_ms(results), daemon["cpu_touching_percent"]
    answering = answers_ms / (10 * DAEMON_TOUCH_S) / core
    share = pad_times(results, "batched")[most] / pad_times(results, "single")[most]
    gain = f"{1 - share:.0%} less" if share < 1 else f"{share - 1:.0%} more"
    company = 1 - (1 - 1 / (DAEMON_TOUCH_S * FRAME_RATE_HZ)) ** (most - 1)
    yield f"""\
How many pads fit on one core, each touched every {DAEMON_TOUCH_S} s and answered three times a touch:

- by the answers alone, {1000 * DAEMON_TOUCH_S / answers_ms:,.0f};
- with tracking and deciding, {daemon["classify_times_real_time"]:,.0f}: by so much the daemon's pipeline
  without a port is faster than real time (`touchd bench`);
- as it runs today, one daemon a pad with its port, {100 / core:,.0f}, at {core:.1f} % of a core and
  {daemon["memory_mb"]:.0f} MB each (`touchd bench`). The answers are {answering:.0%} of that.

A batch of {most} takes {gain} time than as many single answers and {_batch_memory(results, most):.0f} MB
more memory, and its first answer comes no sooner than its last. The shipped file takes any number of windows
of one length at once as it is. A daemon that batched would need a ring and a tracker a pad in one process,
and would answer together what is due in the same frame at the same length: of {most} pads, each touched every
{DAEMON_TOUCH_S} s and unaware of the others, {company:.0%} of the windows have such company; the rest would
have to wait for it.
"""


def _batch_memory(results: Results, pads: int) -> float:
    single, batched = (pad_times(results, way, "peak_bytes")[pads] for way in WAYS)
    return (batched - single) / 1e6
