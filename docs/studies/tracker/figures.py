"""The tracker's figures: misses, false touches, delays, splits, and what other settings would cost."""

from collections.abc import Sequence

import msgspec
import numpy as np

from daemon.touch import TouchSettings
from docs.studies.tracker.measure import Case, Outcome, false_touches, join_touches, notice, outcome, spliced
from drivers.frame import FRAME_RATE_HZ
from drivers.recording import NO_TOUCH, Recording

ONSET_LEVELS = (1.0, 2.0, 3.0, 4.0, 6.0, 8.0, 12.0, 16.0, 24.0)
QUIETS_S = (0.4, 0.5, 0.6, 0.8, 1.0)
MAX_MISSED = 0.02
MAX_FALSE_PER_10_MIN = 1.0
MAX_DELAY_MS = 100.0
FRAME_MS = 1000.0 / FRAME_RATE_HZ


class OnsetPoint(msgspec.Struct, frozen=True, kw_only=True):
    """What one onset level costs. late: noticed over a second after the first visible pressure."""

    onset_threshold: float
    touches: int
    missed: int
    late: int
    delay_ms_median: float
    delay_ms_p90: float
    false_touches: int
    notouch_min: float

    @property
    def false_per_10_min(self) -> float:
        """False touches in ten minutes of notouch."""
        return 10.0 * self.false_touches / self.notouch_min

    def meets(self, strictness: float) -> bool:
        """Whether misses, false touches and delay are within the targets divided by `strictness`."""
        return (
            self.missed * strictness <= MAX_MISSED * self.touches
            and self.false_per_10_min * strictness <= MAX_FALSE_PER_10_MIN
            and self.delay_ms_median <= MAX_DELAY_MS
        )


class QuietPoint(msgspec.Struct, frozen=True, kw_only=True):
    """What one quiet time costs: recordings felt as more than one touch, by gesture."""

    quiet_s: float
    split: dict[str, int]


class TrackedGesture(msgspec.Struct, frozen=True, kw_only=True):
    """One gesture at the default settings.

    split: felt as several touches. ended_early: half a second or more of visible pressure was in no
    touch. not_released: still felt three seconds after the gesture. first_exact: share of touches whose
    first frame is within one frame of the first visible pressure.
    """

    gesture: str
    touches: int
    missed: int
    split: int
    ended_early: int
    not_released: int
    delay_ms_median: float
    delay_ms_p90: float
    from_splice_ms_median: float
    from_splice_ms_p90: float
    first_exact: float


class HeldOut(msgspec.Struct, frozen=True, kw_only=True):
    """One participant at the level chosen on all the others."""

    participant: str
    figures: OnsetPoint


class TouchReport(msgspec.Struct, frozen=True, kw_only=True):
    """Everything measured; each figure as recorded and with rest levelled (see `measure`).

    held_out: training participants. unseen: the test participants together, at the default.
    """

    settings: TouchSettings
    curve: dict[str, tuple[OnsetPoint, ...]]
    held_out: dict[str, tuple[HeldOut, ...]]
    by_gesture: dict[str, tuple[TrackedGesture, ...]]
    quiet: tuple[QuietPoint, ...]
    joins: int
    touched_joins: int
    unseen: dict[str, OnsetPoint]


class Noticed(msgspec.Struct, frozen=True):
    """What one level did with one participant: delays from visible pressure in frames, None for a miss."""

    delays: list[int | None]
    false_touches: int
    notouch_frames: int


def measure(
    recordings: Sequence[Recording], unseen: Sequence[Recording], default: TouchSettings
) -> TouchReport:
    """Measure the tracker on live recordings of gestures and notouch in the same conditions.

    unseen: recordings of participants on whom nothing was tuned.
    """
    cases = _cases(recordings)
    noticed = {name: _at_all_levels(some, recordings, default) for name, some in cases.items()}
    outcomes = {name: [outcome(case, default) for case in some] for name, some in cases.items()}
    joined = [join_touches(_quiet(recordings, name), default) for name in _participants(recordings)]
    return TouchReport(
        settings=default,
        curve={
            name: tuple(point(level, list(people.values())) for level, people in levels.items())
            for name, levels in noticed.items()
        },
        held_out={name: _held_out(levels) for name, levels in noticed.items()},
        by_gesture={name: _by_gesture(some) for name, some in outcomes.items()},
        quiet=tuple(_quiet_point(cases["as recorded"], default, quiet_s) for quiet_s in QUIETS_S),
        joins=sum(joins for joins, _ in joined),
        touched_joins=sum(touched for _, touched in joined),
        unseen={name: _together(some, unseen, default) for name, some in _cases(unseen).items()},
    )


def choose_level(points: Sequence[OnsetPoint]) -> float:
    """Return the middle of the levels that meet the targets with a factor of two to spare.

    The middle by ratio: as far from missing light touches as from false ones. Where no level
    has that to spare, those that just meet the targets count; raises ValueError when none does.
    """
    for strictness in (2.0, 1.0):
        fit = [point.onset_threshold for point in points if point.meets(strictness)]
        if fit:
            middle = np.sqrt(fit[0] * fit[-1])
            return min(fit, key=lambda level: abs(float(np.log(level / middle))))
    raise ValueError("no onset level meets the targets")


def at_level(
    level: float,
    participant: str,
    cases: Sequence[Case],
    recordings: Sequence[Recording],
    default: TouchSettings,
) -> Noticed:
    """Run one participant's cases and notouch recordings at an onset level."""
    settings = msgspec.structs.replace(
        default, onset_threshold=level, release_threshold=min(level, default.release_threshold)
    )
    quiet = _quiet(recordings, participant)
    return Noticed(
        [_delay(case, settings) for case in cases if case.participant == participant],
        sum(false_touches(recording.counts.astype(np.float32), settings) for recording in quiet),
        sum(len(recording.counts) for recording in quiet),
    )


def point(level: float, people: Sequence[Noticed]) -> OnsetPoint:
    """Return the figures of these participants together."""
    delays = [delay for person in people for delay in person.delays]
    felt_ms = np.array([delay for delay in delays if delay is not None]) * FRAME_MS
    return OnsetPoint(
        onset_threshold=level,
        touches=len(delays),
        missed=len(delays) - len(felt_ms),
        late=int((felt_ms > 1000.0).sum()),
        delay_ms_median=round(float(np.median(felt_ms)), 1),
        delay_ms_p90=round(float(np.quantile(felt_ms, 0.9)), 1),
        false_touches=sum(person.false_touches for person in people),
        notouch_min=round(sum(person.notouch_frames for person in people) / FRAME_RATE_HZ / 60.0, 3),
    )


def _at_all_levels(
    cases: Sequence[Case], recordings: Sequence[Recording], default: TouchSettings
) -> dict[float, dict[str, Noticed]]:
    participants = _participants(recordings)
    return {
        level: {name: at_level(level, name, cases, recordings, default) for name in participants}
        for level in ONSET_LEVELS
    }


def _cases(recordings: Sequence[Recording]) -> dict[str, list[Case]]:
    return {"as recorded": spliced(recordings, False), "rest levelled": spliced(recordings, True)}


def _together(cases: Sequence[Case], recordings: Sequence[Recording], default: TouchSettings) -> OnsetPoint:
    level = default.onset_threshold
    people = [at_level(level, name, cases, recordings, default) for name in _participants(recordings)]
    return point(level, people)


def _delay(case: Case, settings: TouchSettings) -> int | None:
    """Return frames from the first visible pressure (0 when it was noticed before), None for a miss."""
    felt = notice(case, settings)
    if felt is None:
        return None
    return max(0, felt.noticed - int(case.visible.argmax())) if case.visible.any() else 0


def _held_out(levels: dict[float, dict[str, Noticed]]) -> tuple[HeldOut, ...]:
    participants = list(next(iter(levels.values())))
    held_out = []
    for left_out in participants:
        points = [
            point(level, [person for name, person in people.items() if name != left_out])
            for level, people in levels.items()
        ]
        level = choose_level(points)
        held_out.append(HeldOut(participant=left_out, figures=point(level, [levels[level][left_out]])))
    return tuple(held_out)


def _by_gesture(outcomes: Sequence[Outcome]) -> tuple[TrackedGesture, ...]:
    gestures = sorted({one.gesture for one in outcomes})
    return tuple(_figures(name, [one for one in outcomes if one.gesture == name]) for name in gestures)


def _figures(gesture: str, outcomes: Sequence[Outcome]) -> TrackedGesture:
    delay_ms = FRAME_MS * np.array(
        [max(0, one.delay_from_visible) for one in outcomes if one.delay_from_visible is not None]
    )
    splice_ms = FRAME_MS * np.array(
        [one.delay_from_splice for one in outcomes if one.delay_from_splice is not None]
    )
    errors = np.array([one.first_error for one in outcomes if one.first_error is not None])
    return TrackedGesture(
        gesture=gesture,
        touches=len(outcomes),
        missed=sum(one.touches == 0 for one in outcomes),
        split=sum(one.touches > 1 for one in outcomes),
        ended_early=sum(one.lost_frames >= FRAME_RATE_HZ / 2 for one in outcomes),
        not_released=sum(not one.released for one in outcomes),
        delay_ms_median=round(float(np.median(delay_ms)), 1),
        delay_ms_p90=round(float(np.quantile(delay_ms, 0.9)), 1),
        from_splice_ms_median=round(float(np.median(splice_ms)), 1),
        from_splice_ms_p90=round(float(np.quantile(splice_ms, 0.9)), 1),
        first_exact=round(float((np.abs(errors) <= 1).mean()), 3),
    )


def _quiet_point(cases: Sequence[Case], default: TouchSettings, quiet_s: float) -> QuietPoint:
    settings = msgspec.structs.replace(default, quiet_s=quiet_s)
    split = dict.fromkeys(sorted({case.gesture for case in cases}), 0)
    for case in cases:
        split[case.gesture] += outcome(case, settings).touches > 1
    return QuietPoint(quiet_s=quiet_s, split=split)


def _participants(recordings: Sequence[Recording]) -> list[str]:
    return sorted({recording.participant for recording in recordings})


def _quiet(recordings: Sequence[Recording], participant: str) -> list[Recording]:
    return [one for one in recordings if one.gesture == NO_TOUCH and one.participant == participant]
