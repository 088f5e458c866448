"""Pictures of recordings: pressure, touches, answers, mean pads."""

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import cycle, pairwise
from typing import TypeAlias

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from touchd.daemon.app.config import Settings
from touchd.daemon.path.events import UNCERTAIN, Event, Prediction, TouchBegan
from touchd.daemon.path.pipeline import Pipeline
from touchd.daemon.playback.stream import play
from touchd.daemon.sinks.touches import ReportedTouch, gather
from touchd.drivers.errors import TouchdError
from touchd.drivers.frame import FRAME_RATE_HZ, NO_TOUCH, OTHER
from touchd.drivers.recording import UNLABELLED, Span, Stream
from touchd.model.classifier import Classifier

# One for each stage at a mark, and one for those about touches that are over or go on.
LANES = ("early", "revised", "final", "released, later")
INK, QUIET_INK, PALE = "#222222", "#777777", "#e4e4e4"
# Names may contain what matplotlib parses as a formula.
mpl.rc("text", parse_math=False)
mpl.rc("figure", dpi=130, titlesize=11)
mpl.rc("axes", titlesize=8, titlecolor=QUIET_INK, labelsize=8, labelcolor=QUIET_INK, edgecolor=QUIET_INK)
mpl.rc("axes", axisbelow=True)
mpl.rc("axes.spines", top=False, right=False)
mpl.rc("grid", color=PALE)
mpl.rc("xtick", color=QUIET_INK, labelsize=8)
mpl.rc("ytick", color=QUIET_INK, labelsize=8)
Colours: TypeAlias = Mapping[str, str]
# Okabe and Ito's palette for colour-blind people; OTHER_COLOURS are for a lab's own gestures.
COLOURS: Colours = {
    "constant": "#0072b2",
    "pat": "#e69f00",
    "rub": "#009e73",
    "scratch": "#d55e00",
    "stroke": "#cc79a7",
    "tickle": "#56b4e9",
    OTHER: "#000000",
    NO_TOUCH: "#9a9a9a",
    UNCERTAIN: "#9a9a9a",
}
OTHER_COLOURS = ("#6a4c93", "#8c564b", "#b5a800", "#3d405b")
# In inches, and seconds.
WIDTH, TITLE, ROW, PADS = 12.0, 0.8, 2.5, 2.0
ROW_S, LONGEST_S = 24.0, 300.0
LEGEND = "filled: sent to the robot    red: another gesture was performed    grey: a touch was detected"
LEAST_PADS, MOST_PADS = 4, 7
LIGHTEST_FRAMES = 9
# Lowest upper end of the scale, so that noise does not look like a touch.
LEAST_SCALE_COUNTS = 100.0


class PlotError(TouchdError):
    """A picture cannot be made; the message says what to do."""


def colours_of(gestures: Iterable[str]) -> dict[str, str]:
    """Return a colour for each gesture of a picture."""
    own = sorted(set(gestures) - COLOURS.keys())
    return {**COLOURS, **dict(zip(own, cycle(OTHER_COLOURS), strict=False))}


@dataclass(frozen=True, eq=False)
class Trace:
    """A stream and what the pipeline made of it.

    time_s: (T,) since the first recorded frame; negative in quiet that was added before it. rise: (T, 8, 8)
    counts above the lightest moment.
    """

    stream: Stream
    time_s: NDArray[np.float64]
    rise: NDArray[np.float64]
    touches: list[ReportedTouch]
    starts_s: list[float]

    def ends_s(self, number: int) -> float:
        ended = self.touches[number].ended
        return self.starts_s[number] + (ended.frames if ended else 0) / FRAME_RATE_HZ

    def truth(self, number: int) -> str:
        """Return the recorded gesture that a touch overlaps most."""
        start_s, end_s = self.starts_s[number], self.ends_s(number)

        def overlap_s(span: Span) -> float:
            first_s, last_s = self.time_s[[span.start, span.stop - 1]].tolist()
            return float(min(end_s, last_s) - max(start_s, first_s))

        return max(self.stream.spans, key=overlap_s).gesture

    def rows(self) -> list[tuple[float, float]]:
        """Return start and end of each row of the picture in seconds; all are of one length."""
        end_s = float(self.time_s[_recorded(self.stream)[1] - 1])
        ends_s = np.linspace(0.0, end_s, max(1, math.ceil(end_s / ROW_S)) + 1)
        return list(pairwise(ends_s.tolist()))


def trace(stream: Stream, settings: Settings, model: Classifier) -> Trace:
    """Send a stream through the pipeline; raises PlotError when it is too long for one picture."""
    steps_ms = np.diff(stream.sensor_ms)
    # The clock jumps back when the pad restarts; the time axis must not.
    restarts = np.flatnonzero(steps_ms <= 0) + 1
    steps_ms = np.where(steps_ms > 0, steps_ms, 1000 / FRAME_RATE_HZ)
    time_s = np.concatenate([[0.0], np.cumsum(steps_ms)]) / 1000
    time_s -= time_s[_recorded(stream)[0]]
    if (length_s := time_s[_recorded(stream)[1] - 1]) > LONGEST_S:
        raise PlotError(
            f"{length_s:.0f} s do not fit in one picture ({LONGEST_S:g} s at most); select with "
            "--participant, --substrate, --cover or --gesture"
        )
    events: list[Event] = []
    starts_s: list[float] = []
    frames: list[int] = []

    def emit(event: Event) -> None:
        events.append(event)
        if isinstance(event, TouchBegan):
            # A touch begins a little before it is detected.
            latest = frames[-1]
            starts_s.append(float(time_s[latest]) - (int(stream.sensor_ms[latest]) - event.sensor_ms) / 1000)

    play(stream, lambda clock: Pipeline(settings.pipeline, model, emit, clock), frames.append)
    return Trace(stream, time_s, _rise(stream, restarts), gather(events), starts_s)


def _recorded(stream: Stream) -> tuple[int, int]:
    """Return the first frame that is in a recording, and the one after the last."""
    own = [span for span in stream.spans if not span.is_added]
    return own[0].start, own[-1].stop


def _rise(stream: Stream, restarts: NDArray[np.int64]) -> NDArray[np.float64]:
    """Return (T, 8, 8) counts above the sixth of a second with the least pressure.

    When the pad restarts, its rest may change.
    """
    rise = stream.counts.astype(np.float64)
    is_sent = np.ones(len(rise), dtype=np.bool_)
    for span in stream.spans:
        # Added quiet without any change was made from each taxel's lowest count.
        counts = stream.counts[span.start : span.stop]
        is_sent[span.start : span.stop] = not span.is_added or np.ptp(counts, axis=0).any()
    for part, sent in zip(np.split(rise, restarts), np.split(is_sent, restarts), strict=True):
        own = part[sent]
        frames = min(LIGHTEST_FRAMES, len(own))
        first = int(np.convolve(own.sum(axis=(1, 2)), np.ones(frames), "valid").argmin())
        part -= own[first : first + frames].mean(axis=0)
    return rise


def draw_recording(traced: Trace, title: str) -> Figure:
    """Draw pressure over time, detected touches, answers, mean pads."""
    recorded = {span.gesture for span in traced.stream.spans}
    answered = {answer.gesture for touch in traced.touches for answer in touch.predictions}
    gestures, colours = sorted(recorded - {NO_TOUCH}), colours_of(recorded | answered)
    rows = traced.rows()
    columns = min(MOST_PADS, max(LEAST_PADS, len(gestures)))
    pad_rows = math.ceil(len(gestures) / columns)
    heights = [ROW * len(rows), *([PADS * pad_rows] if gestures else [])]
    figure = Figure(figsize=(WIDTH, sum(heights) + TITLE), layout="constrained")
    figure.suptitle(title)
    parts = figure.subfigures(len(heights), 1, height_ratios=heights, squeeze=False)[:, 0]
    axes = parts[0].subplots(2 * len(rows), 1, squeeze=False, height_ratios=[1.0, 1.6] * len(rows))[:, 0]
    for row, (begin_s, end_s) in enumerate(rows):
        answers, pressure = axes[2 * row : 2 * row + 2]
        _draw_answers(answers, traced, colours, begin_s, end_s)
        _draw_pressure(pressure, traced, colours, begin_s, end_s)
        for part in (answers, pressure):
            part.set_xlim(begin_s, end_s)
    axes[0].set_title(LEGEND, loc="right")
    axes[-1].set_xlabel("seconds")
    if gestures:
        _draw_pads(parts[1].subplots(pad_rows, columns, squeeze=False).ravel(), traced, gestures, colours)
    return figure


def _draw_pressure(axes: Axes, traced: Trace, colours: Colours, begin_s: float, end_s: float) -> None:
    """Draw the total pressure in the colour of the recorded gesture, and shade detected touches."""
    first, last = np.searchsorted(traced.time_s, [begin_s, end_s]).tolist()
    load = traced.rise.sum(axis=(1, 2))
    highest = max(float(load[first : last + 1].max()), LEAST_SCALE_COUNTS)
    for number in range(len(traced.touches)):
        start_s, stop_s = traced.starts_s[number], traced.ends_s(number)
        axes.axvspan(start_s, stop_s, color=PALE, linewidth=0, zorder=0)
    for span in traced.stream.spans:
        part = slice(max(span.start, first), min(span.stop, last + 1))
        if span.is_added or len(load[part]) == 0:
            continue
        colour = colours[span.gesture]
        axes.fill_between(traced.time_s[part], load[part], color=colour, alpha=0.45, linewidth=0)
        axes.plot(traced.time_s[part], load[part], color=colour, linewidth=0.9)
        if span.gesture != NO_TOUCH:
            place = traced.time_s[part].mean(), 1.04 * highest
            axes.text(*place, span.gesture, color=colour, clip_on=True, ha="center", fontweight="bold")
    axes.set_ylim(min(0.0, float(load[first : last + 1].min())), 1.25 * highest)
    axes.set_ylabel("counts above lightest")


def _draw_answers(axes: Axes, traced: Trace, colours: Colours, begin_s: float, end_s: float) -> None:
    """Draw each answer at its time, but none after the end, in the lane of its stage."""
    last_s = np.nextafter(traced.rows()[-1][1], 0.0)
    for number, touch in enumerate(traced.touches):
        truth = traced.truth(number)
        for answer in touch.predictions:
            at_s = min(traced.starts_s[number] + answer.elapsed_s, last_s)
            if begin_s <= at_s < end_s:
                is_wrong = truth != UNLABELLED and answer.gesture not in (truth, UNCERTAIN)
                lane = LANES.index(answer.stage) if answer.stage in LANES else len(LANES) - 1
                _draw_answer(axes, (at_s, -lane), answer, colours[answer.gesture], is_wrong)
    axes.set_ylim(-len(LANES) + 0.4, 0.6)
    axes.set_yticks([-lane for lane in range(len(LANES))], LANES)
    axes.set_xticks([])
    axes.grid(axis="y")
    axes.spines[:].set_visible(False)
    axes.tick_params(length=0)


def _draw_answer(
    axes: Axes, at: tuple[float, float], answer: Prediction, colour: str, is_wrong: bool
) -> None:
    """Draw an answer, filled if it was sent to the robot."""
    inside = colour if answer.told else "white"
    axes.plot(*at, "o", markeredgecolor=colour, markerfacecolor=inside, clip_on=False, zorder=3)
    is_unsure = answer.gesture == UNCERTAIN
    axes.annotate(
        UNCERTAIN if is_unsure else f"{answer.gesture} {answer.confidence:.0%}",
        at,
        xytext=(6, 0),
        textcoords="offset points",
        va="center",
        fontsize=7.5,
        color="#c00000" if is_wrong else INK,
        fontstyle="italic" if is_wrong else "normal",
        annotation_clip=False,
    )


def _draw_pads(all_axes: Sequence[Axes], traced: Trace, gestures: Sequence[str], colours: Colours) -> None:
    """Draw the mean pad of each gesture, each on its own scale so that light touches are visible."""
    for axes in all_axes:
        axes.set_axis_off()
    for axes, gesture in zip(all_axes, gestures, strict=False):
        spans = [span for span in traced.stream.spans if span.gesture == gesture]
        mean = np.concatenate([traced.rise[span.start : span.stop] for span in spans]).mean(axis=0)
        highest = max(float(mean.max()), 1.0)
        axes.imshow(mean, cmap="inferno", vmin=0, vmax=highest)
        title = f"{gesture}\nmean pad, 0 to {highest:.0f}"
        axes.set_title(title, color=colours[gesture], fontweight="bold")
