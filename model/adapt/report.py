"""Reports accuracy before and after adapting, in words and a table of 80 columns, and how certain it is."""

import textwrap
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from typing import Literal, TypeAlias

from touchd.drivers.frame import OTHER
from touchd.model.adapt.adapt import Adapted
from touchd.model.adapt.measure import Comparison, GestureFigures, LengthFigures
from touchd.model.adapt.plan import LeftOut

# If all of three recordings are right, the Wilson interval begins at 44 %; with four, at 51 %.
FEW_RECORDINGS = 4
# If two participants happen to change equally, the interval has no width.
FEW_PARTICIPANTS = 3

Verdict: TypeAlias = Literal["better", "worse", "unclear"]
WIDTH = 80
NAME_WIDTH = 20
NO_NAMES: Mapping[str, str] = {}
MEASURED: dict[LeftOut, str] = {
    "participants": "Right answers in percent, several a recording. Each participant is answered by a model "
    "adapted to the others: this is how well it will do on people it was not adapted to.",
    "recordings": "Right answers in percent, several a recording. Each recording is answered by a model "
    "adapted to others of the same participant: this is how well it will do on this person.",
    "nothing": "Adapted to all of them. No figures: there are too few recordings to hold any out.",
}


def report_lines(adapted: Adapted, names: Mapping[str, str] = NO_NAMES) -> Iterable[str]:
    """Yield the report: the recordings, accuracy before and after, and warnings.

    names: what gestures are called; without one, as in the recordings.
    """
    recordings = adapted.recordings
    gestures = Counter(recording.gesture for recording in recordings)
    participants = {recording.participant for recording in recordings}
    new = [gesture for gesture in gestures if gesture not in adapted.known]
    yield (
        f"{_count(len(recordings), 'recording')} of {_count(len(gestures), 'gesture')} "
        f"by {_count(len(participants), 'participant')}"
    )
    if new:
        yield f"New to the model: {_listed(sorted(new), names)}"
    for reason, number in adapted.passed_over.items():
        yield f"Passed over: {_count(number, 'saved touch', 'es')} {reason}"
    comparison = adapted.comparison
    yield ""
    yield from textwrap.wrap(MEASURED[comparison.left_out], WIDTH)
    if comparison.lengths:
        yield ""
        yield from _table(comparison.lengths, names)
    if comparison.in_passing is not None:
        yield ""
        yield from _in_passing(comparison.in_passing, names)
    yield ""
    for warning in warnings(adapted, names):
        yield from textwrap.wrap(f"! {warning}", WIDTH, subsequent_indent="  ")


def warnings(adapted: Adapted, names: Mapping[str, str]) -> Iterable[str]:
    """Yield warnings to read before using the adapted model, a line each."""
    comparison = adapted.comparison
    gestures = Counter(recording.gesture for recording in adapted.recordings)
    yield from _doubts(comparison)
    few = sorted(gesture for gesture, count in gestures.items() if count < FEW_RECORDINGS)
    # Of one person it is always so, and the table's last column says how sure each figure is.
    if few and comparison.left_out == "participants":
        yield (
            f"Fewer than {FEW_RECORDINGS} recordings of {_listed(few, names)}: too few to tell how well they "
            "are known."
        )
    people = {(recording.gesture, recording.participant) for recording in adapted.recordings}
    alone = sorted(gesture for gesture, who in Counter(gesture for gesture, _ in people).items() if who == 1)
    if comparison.left_out == "participants" and alone:
        yield f"Only one participant did {_listed(alone, names)}: no figure for other people."
    if gone := sorted(set(adapted.known) - set(adapted.labels)):
        yield f"The new model no longer knows {_listed(gone, names)}: record them too, or give --keep-all."
    # Nobody need record what is none of the gestures.
    if lacking := [label for label in adapted.labels if label not in gestures and label != OTHER]:
        yield f"No recording of {_listed(lacking, names)}: known from other people and pads only."


def _doubts(comparison: Comparison) -> Iterable[str]:
    """Yield whether adapting can be said to have helped."""
    if comparison.left_out == "nothing":
        yield (
            "Too few recordings to leave any out: whether this is better than the shipped model cannot be "
            "told."
        )
    elif comparison.left_out == "recordings":
        yield "One participant: no figure for other people, for whom the model may have become worse."
    if not comparison.lengths or comparison.lengths[-1].difference is None:
        return
    if _are_few(comparison):
        yield f"Fewer than {FEW_PARTICIPANTS} participants: too few to tell whether others gain."
    elif verdict(comparison) == "unclear":
        yield "Too little to tell whether this is better or worse: chance alone makes such a difference."
    elif verdict(comparison) == "worse":
        yield "This is worse than the shipped model: keep that, or record more."


def verdict(comparison: Comparison) -> Verdict:
    """Return what the last answers of held-out recordings say of the new model, as far as chance allows."""
    interval = comparison.lengths[-1].interval if comparison.lengths else None
    if interval is None or _are_few(comparison):
        return "unclear"
    return "better" if interval[0] > 0.0 else "worse" if interval[1] < 0.0 else "unclear"


def _are_few(comparison: Comparison) -> bool:
    return comparison.left_out == "participants" and comparison.participants < FEW_PARTICIPANTS


def _in_passing(figures: LengthFigures, names: Mapping[str, str]) -> Iterable[str]:
    """Yield a line for each gesture of ended touches in passing, and one for all."""
    yield "Touches in passing, answered once the hand has gone: tried, before, after"
    for gesture, own in figures.gestures.items():
        before = "-" if own.before is None else _percent(own.before)
        shown = names.get(gesture, gesture)[: NAME_WIDTH - 1]
        yield f"{shown:<{NAME_WIDTH}}{own.recordings:>6}  {before:>6} {_percent(own.after):>6}"
    if figures.difference is not None:
        yield f"in passing: {100 * figures.difference:+.1f} points{_reach(figures)}"


def _reach(at: LengthFigures) -> str:
    """Return the interval of a difference in words."""
    if at.interval is None:
        return ", no interval: too few"
    return f", 95 % interval {100 * at.interval[0]:+.1f} to {100 * at.interval[1]:+.1f}"


def _table(lengths: Sequence[LengthFigures], names: Mapping[str, str]) -> Iterable[str]:
    """Yield a table, a line per gesture: before and after at each answer, and the last answer's interval."""
    yield f"{'':<{NAME_WIDTH}}{'':>6}" + "".join(f"  {f'{at.frames / 54:.2f} s':>13}" for at in lengths)
    yield (
        f"{'gesture':<{NAME_WIDTH}}{'tried':>6}"
        + "".join(f"  {'before':>6} {'after':>6}" for _ in lengths)
        + "  95 %"
    )
    for gesture in dict.fromkeys(name for at in lengths for name in at.gestures):
        own = [at.gestures.get(gesture) for at in lengths]
        counted = max(figures.recordings for figures in own if figures is not None)
        last = own[-1]
        interval = "" if last is None else f"  {_percent(last.interval[0])}-{_percent(last.interval[1])}"
        shown = names.get(gesture, gesture)[: NAME_WIDTH - 1]
        yield f"{shown:<{NAME_WIDTH}}{counted:>6}{_cells(own)}{interval}"
    if lengths[-1].before is not None:
        yield f"{'mean of those known':<{NAME_WIDTH}}{'':>6}{_cells(lengths)}"
    if any(figures.before is None for figures in lengths[-1].gestures.values()):
        cells = "".join(f"  {'':>6} {_percent(at.all_after):>6}" for at in lengths)
        yield f"{'mean of all':<{NAME_WIDTH}}{'':>6}{cells}"
    for at in lengths:
        if at.difference is not None:
            yield f"after {at.frames / 54:.2f} s: {100 * at.difference:+.1f} points{_reach(at)}"


def _cells(row: Iterable[GestureFigures | LengthFigures | None]) -> str:
    """Return the accuracies before and after at each answer, "-" where one is missing."""
    pairs = [(None, None) if figures is None else (figures.before, figures.after) for figures in row]
    return "".join(f"  {_percent(before):>6} {_percent(after):>6}" for before, after in pairs)


def _listed(gestures: Iterable[str], names: Mapping[str, str]) -> str:
    return ", ".join(names.get(gesture, gesture) for gesture in gestures)


def _percent(share: float | None) -> str:
    return "-" if share is None else f"{100 * share:.0f}"


def _count(number: int, what: str, ending: str = "s") -> str:
    return f"{number} {what}{'' if number == 1 else ending}"
