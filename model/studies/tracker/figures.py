"""The tracker's figures: misses, false touches, delays, splits, and what other settings would cost."""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Any

import msgspec
import numpy as np
from numpy.typing import NDArray

from touchd.daemon.path.tracker.tracker import TouchSettings
from touchd.drivers.frame import FRAME_RATE_HZ, NO_TOUCH
from touchd.drivers.recording import Recording
from touchd.model.studies.tracker.measure import (
    Case,
    Outcome,
    delay,
    false_touches,
    join_touches,
    outcome,
    spliced,
)

ONSET_LEVELS = (1.0, 2.0, 3.0, 4.0, 6.0, 8.0, 12.0, 16.0, 24.0)
SPLICES = {"as recorded": False, "rest levelled": True}
"""Whether the notouch is shifted to the gesture's own rest."""
NOISE_COUNTS = 1.0
"""Standard deviation of the noise added to each taxel, for pads that are noisier than the recordings'."""
QUIETS_S = (0.4, 0.5, 0.6, 0.8, 1.0)
MAX_MISSED = 0.02
MAX_FALSE_PER_10_MIN = 1.0
MAX_DELAY_MS = 100.0
FRAME_MS = 1000.0 / FRAME_RATE_HZ


class OnsetPoint(msgspec.Struct, frozen=True, kw_only=True):
    """What one onset level costs. late: detected over a second after the first visible pressure."""

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
    """What one quiet time costs: recordings detected as more than one touch, by gesture."""

    quiet_s: float
    split: dict[str, int]


class NoisyPoint(msgspec.Struct, frozen=True, kw_only=True):
    """False touches of one onset level in the same notouch with NOISE_COUNTS added."""

    onset_threshold: float
    false_per_10_min: float


class TrackedGesture(msgspec.Struct, frozen=True, kw_only=True):
    """One gesture at the default settings.

    split: detected as several touches. ended_early: half a second or more of visible pressure was in no
    touch. not_released: still open three seconds after the gesture. first_exact: share of touches whose
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

    noisy: false touches on a noisier pad, as recorded. held_out: training participants. unseen: the test
    participants together, at the default.
    """

    settings: TouchSettings
    curve: dict[str, tuple[OnsetPoint, ...]]
    noisy: tuple[NoisyPoint, ...]
    held_out: dict[str, tuple[HeldOut, ...]]
    by_gesture: dict[str, tuple[TrackedGesture, ...]]
    quiet: tuple[QuietPoint, ...]
    joins: int
    touched_joins: int
    unseen: dict[str, OnsetPoint]


class LevelOutcome(msgspec.Struct, frozen=True):
    """Result of one level for one participant: delays from visible pressure in frames, None for a miss."""

    delays: list[int | None]
    false_touches: int
    notouch_frames: int


def measure(
    recordings: Sequence[Recording], unseen: Sequence[Recording], default: TouchSettings
) -> TouchReport:
    """Measure the tracker on live recordings of gestures and notouch in the same conditions.

    unseen: recordings of participants on whom nothing was tuned.
    """
    joined = [join_touches(own, default) for own in _quiet(recordings).values()]
    figures: dict[str, dict[str, Any]] = {name: {} for name in ("curve", "held_out", "by_gesture", "unseen")}
    for splice, level_rest in SPLICES.items():
        cases = spliced(recordings, level_rest)
        levels = {level: _at_level(level, cases, recordings, default) for level in ONSET_LEVELS}
        figures["curve"][splice] = tuple(point(level, people.values()) for level, people in levels.items())
        figures["held_out"][splice] = tuple(_held_out(name, levels) for name in levels[ONSET_LEVELS[0]])
        figures["by_gesture"][splice] = tuple(_by_gesture([outcome(case, default) for case in cases]))
        level, others = default.onset_threshold, spliced(unseen, level_rest)
        figures["unseen"][splice] = point(level, _at_level(level, others, unseen, default).values())
    as_recorded = spliced(recordings, level_rest=False)
    return TouchReport(
        settings=default,
        noisy=noisy_points(recordings, default),
        quiet=tuple(_quiet_point(as_recorded, default, quiet_s) for quiet_s in QUIETS_S),
        joins=sum(joins for joins, _ in joined),
        touched_joins=sum(touched for _, touched in joined),
        **figures,
    )


def noisy_points(recordings: Sequence[Recording], default: TouchSettings) -> tuple[NoisyPoint, ...]:
    """Return the false touches in ten minutes of notouch with noise added, at each onset level."""
    rng = np.random.default_rng(0)
    quiet = [one.counts for one in recordings if one.gesture == NO_TOUCH]
    noisy = [(scans + NOISE_COUNTS * rng.normal(size=scans.shape)).clip(0).round() for scans in quiet]
    minutes = sum(map(len, quiet)) / FRAME_RATE_HZ / 60.0
    points = []
    for level in ONSET_LEVELS:
        settings = msgspec.structs.replace(default, onset_threshold=level)
        false = sum(false_touches(scans.astype(np.float32), settings) for scans in noisy)
        points.append(NoisyPoint(onset_threshold=level, false_per_10_min=round(10.0 * false / minutes, 1)))
    return tuple(points)


def choose_level(points: Sequence[OnsetPoint]) -> float:
    """Return the middle of the levels that meet the targets with a factor of two to spare.

    The middle by ratio is as far from missing light touches as from false ones. If no level has that to
    spare, those that just meet the targets count; raises ValueError if none does.
    """
    for strictness in (2.0, 1.0):
        fit = [point.onset_threshold for point in points if point.meets(strictness)]
        if fit:
            middle = np.sqrt(fit[0] * fit[-1])
            return min(fit, key=lambda level: abs(float(np.log(level / middle))))
    raise ValueError("no onset level meets the targets")


def at_level(
    level: float, cases: Sequence[Case], quiet: Sequence[Recording], default: TouchSettings
) -> LevelOutcome:
    """Run one participant's cases and notouch recordings at an onset level."""
    settings = msgspec.structs.replace(default, onset_threshold=level)
    return LevelOutcome(
        [delay(case, settings) for case in cases],
        sum(false_touches(recording.counts.astype(np.float32), settings) for recording in quiet),
        sum(len(recording.counts) for recording in quiet),
    )


def point(level: float, outcomes: Iterable[LevelOutcome]) -> OnsetPoint:
    """Return the figures of these participants together."""
    people = list(outcomes)
    delays = [frames for person in people for frames in person.delays]
    delays_ms = np.array([frames for frames in delays if frames is not None]) * FRAME_MS
    return OnsetPoint(
        onset_threshold=level,
        touches=len(delays),
        missed=len(delays) - len(delays_ms),
        late=int((delays_ms > 1000.0).sum()),
        delay_ms_median=_quantile(delays_ms, 0.5),
        delay_ms_p90=_quantile(delays_ms, 0.9),
        false_touches=sum(person.false_touches for person in people),
        notouch_min=round(sum(person.notouch_frames for person in people) / FRAME_RATE_HZ / 60.0, 3),
    )


def _at_level(
    level: float, cases: Sequence[Case], recordings: Sequence[Recording], default: TouchSettings
) -> dict[str, LevelOutcome]:
    """Return each participant's outcome at an onset level."""
    return {
        name: at_level(level, [case for case in cases if case.participant == name], quiet, default)
        for name, quiet in _quiet(recordings).items()
    }


def _quiet(recordings: Sequence[Recording]) -> dict[str, list[Recording]]:
    """Return each participant's notouch recordings."""
    quiet = [one for one in recordings if one.gesture == NO_TOUCH]
    names = sorted({one.participant for one in quiet})
    return {name: [one for one in quiet if one.participant == name] for name in names}


def _quantile(ms: NDArray[np.float64], share: float) -> float:
    return round(float(np.quantile(ms, share)), 1)


def _held_out(left_out: str, levels: Mapping[float, Mapping[str, LevelOutcome]]) -> HeldOut:
    points = [
        point(level, (person for name, person in people.items() if name != left_out))
        for level, people in levels.items()
    ]
    level = choose_level(points)
    return HeldOut(participant=left_out, figures=point(level, [levels[level][left_out]]))


def _by_gesture(outcomes: Sequence[Outcome]) -> Iterator[TrackedGesture]:
    for gesture in sorted({one.gesture for one in outcomes}):
        yield _tracked(gesture, [one for one in outcomes if one.gesture == gesture])


def _tracked(gesture: str, outcomes: Sequence[Outcome]) -> TrackedGesture:
    detected = [one for one in outcomes if one.touches]
    seen = [one for one in detected if one.delay_from_visible is not None]
    delay_ms = FRAME_MS * np.array([max(0, one.delay_from_visible or 0) for one in seen])
    splice_ms = FRAME_MS * np.array([one.delay_from_splice for one in detected])
    errors = np.array([one.first_error for one in seen])
    return TrackedGesture(
        gesture=gesture,
        touches=len(outcomes),
        missed=sum(one.touches == 0 for one in outcomes),
        split=sum(one.touches > 1 for one in outcomes),
        ended_early=sum(one.lost_frames >= FRAME_RATE_HZ / 2 for one in outcomes),
        not_released=sum(not one.released for one in outcomes),
        delay_ms_median=_quantile(delay_ms, 0.5),
        delay_ms_p90=_quantile(delay_ms, 0.9),
        from_splice_ms_median=_quantile(splice_ms, 0.5),
        from_splice_ms_p90=_quantile(splice_ms, 0.9),
        first_exact=round(float((np.abs(errors) <= 1).mean()), 3),
    )


def _quiet_point(cases: Sequence[Case], default: TouchSettings, quiet_s: float) -> QuietPoint:
    settings = msgspec.structs.replace(default, quiet_s=quiet_s)
    split = dict.fromkeys(sorted({case.gesture for case in cases}), 0)
    for case in cases:
        split[case.gesture] += outcome(case, settings).touches > 1
    return QuietPoint(quiet_s=quiet_s, split=split)
