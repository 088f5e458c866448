"""Reports accuracy before and after adapting, in words and a table of 80 columns, and how certain it is."""

import textwrap
from collections import Counter
from collections.abc import Iterable

from touchd.drivers.frame import FRAME_RATE_HZ, OTHER
from touchd.model.adapt.adapt import Adapted
from touchd.model.adapt.measure import Comparison, LeftOut, LengthFigures
from touchd.model.adapt.passing import IN_PASSING

# If two participants happen to change equally, the interval has no width.
FEW_PARTICIPANTS = 3
WIDTH = 80
NAME_WIDTH = 20
RIGHT = "Right answers in percent, several a recording. Each"
MEASURED: dict[LeftOut, str] = {
    "participants": f"{RIGHT} participant is answered by a model adapted to the others: this is how well it "
    "will do on people it was not adapted to.",
    "recordings": f"{RIGHT} recording is answered by a model adapted to others of the same participant: this "
    "is how well it will do on this person.",
    "nothing": "Adapted to all of them. No figures: there are too few recordings to hold any out.",
}


def report_lines(adapted: Adapted) -> Iterable[str]:
    """Yield the report: the recordings, accuracy before and after, and warnings."""
    comparison, gestures = adapted.comparison, {recording.gesture for recording in adapted.recordings}
    participants = {recording.participant for recording in adapted.recordings}
    yield (
        f"{_count(len(adapted.recordings), 'recording')} of {_count(len(gestures), 'gesture')} "
        f"by {_count(len(participants), 'participant')}"
    )
    if new := sorted(gestures - {*adapted.known}):
        yield f"New to the model: {', '.join(new)}"
    for reason, number in adapted.passed_over.items():
        yield f"Passed over: {_count(number, 'saved touch', 'es')} {reason}"
    yield ""
    yield from textwrap.wrap(MEASURED[comparison.left_out], WIDTH)
    if comparison.lengths:
        yield from _table(comparison.lengths[-1])
        yield from map(_gain, comparison.lengths)
    yield ""
    for warning in filter(None, (_doubt(comparison), *_lacks(adapted))):
        yield from textwrap.wrap(f"! {warning}", WIDTH, subsequent_indent="  ")


def is_better(comparison: Comparison) -> bool:
    """Return whether the adapted model is known to be right more often than the shipped one."""
    return not _doubt(comparison)


def _doubt(comparison: Comparison) -> str:
    """Return why adapting cannot be said to have helped; "" if it can."""
    if not comparison.lengths:
        return "Too few recordings to hold any out: whether this is better than the shipped model is unknown."
    interval = comparison.lengths[-1].interval
    if comparison.left_out == "participants" and comparison.participants < FEW_PARTICIPANTS:
        return f"Fewer than {FEW_PARTICIPANTS} participants: too few to tell whether others gain."
    if interval is None or interval[0] <= 0.0 <= interval[1]:
        return "Too little to tell whether this is better or worse: chance alone makes such a difference."
    return "This is worse than the shipped model: keep that, or record more." if interval[1] < 0.0 else ""


def _lacks(adapted: Adapted) -> Iterable[str]:
    """Yield what the recordings do not show of a gesture."""
    done_by = Counter(
        gesture for gesture, _ in {(each.gesture, each.participant) for each in adapted.recordings}
    )
    alone = sorted(gesture for gesture, people in done_by.items() if people == 1)
    if adapted.comparison.left_out == "recordings":
        yield "One participant: no figure for other people, for whom the model may have become worse."
    if adapted.comparison.left_out == "participants" and alone:
        yield f"Only one participant did {', '.join(alone)}: no figure for other people."
    if gone := sorted(set(adapted.known) - set(adapted.labels)):
        yield f"The new model no longer knows {', '.join(gone)}: record them too, or give --keep-all."
    # Nobody need record what is none of the gestures.
    if lacking := sorted({*adapted.labels} - {*done_by, OTHER}):
        yield f"No recording of {', '.join(lacking)}: known from other people and pads only."


def _table(figures: LengthFigures) -> Iterable[str]:
    """Yield a line per gesture: how many recordings, and the accuracy before and after."""
    yield ""
    yield f"{_title(figures):<{NAME_WIDTH}}{'tried':>6}{'before':>8}{'after':>7}"
    for gesture, own in figures.gestures.items():
        shown = gesture[: NAME_WIDTH - 1]
        yield f"{shown:<{NAME_WIDTH}}{own.recordings:>6}{_percent(own.before):>8}{_percent(own.after):>7}"
    if figures.before is not None:
        before, after = _percent(figures.before), _percent(figures.after)
        yield f"{'mean of those known':<{NAME_WIDTH}}{'':>6}{before:>8}{after:>7}"


def _gain(at: LengthFigures) -> str:
    """Return what adapting gained, in points, and its interval."""
    if at.before is None or at.after is None:
        return f"{_title(at)}: new gestures only"
    interval = "no interval: too few"
    if at.interval is not None:
        interval = f"95 % interval {100 * at.interval[0]:+.1f} to {100 * at.interval[1]:+.1f}"
    return f"{_title(at)}: {100 * (at.after - at.before):+.1f} points, {interval}"


def _title(figures: LengthFigures) -> str:
    return "in passing" if figures.frames == IN_PASSING else f"after {figures.frames / FRAME_RATE_HZ:.2f} s"


def _percent(share: float | None) -> str:
    return "-" if share is None else f"{100 * share:.0f}"


def _count(number: int, what: str, ending: str = "s") -> str:
    return f"{number} {what}{'' if number == 1 else ending}"
