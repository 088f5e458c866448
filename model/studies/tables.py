"""Every figure of detection and of what is said in use, in one file: `python -m touchd.model.studies tables`.

A change is judged by it: sessions, also disturbed; streams of another pad; touches in passing; hands that
change; a firm pad; how soon a touch is found. Networks never saw the people, but for the pads never met.
Results are stored one by one, so an interrupted run resumes. `--against FILE` prints what differs.
"""

import logging
import sys
from collections.abc import Callable, Iterable, Iterator, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from touchd.daemon.path.events import Event, TouchBegan, epoch_s
from touchd.drivers.frame import FRAME_RATE_HZ, MAX_COUNT, NO_TOUCH, Counts, Frame
from touchd.model.classifier import SHIPPED_MODEL, Classifier
from touchd.model.studies.checks.evaluate import Split
from touchd.model.studies.detection.cases import Case, spliced
from touchd.model.studies.folders import study_parser
from touchd.model.studies.play import frames_of, play
from touchd.model.studies.results import STORED, Results
from touchd.model.studies.sessions import changes, firm_pad, passing, streams
from touchd.model.studies.sessions.plan import SessionSettings, sessions
from touchd.model.studies.sessions.score import judge, score
from touchd.model.training import haart, second_study, third_study
from touchd.model.training.weights import FABRIC_MODEL, left_out_split

DISTURBED = {
    "noise": SessionSettings(noise=1.5),
    "hum": SessionSettings(hum=2.0),
    "motor": SessionSettings(motor=2.0),
    "breathing": SessionSettings(breathing=2.0),
}
FIRM_RATES = ((12.0, 54.0), (8.0, 54.0), (12.0, 12.0))
"""How fast the firm pad's recordings ran, and how many frames a second are sent."""
NOISE_COUNTS = 1.0
Figures = dict[str, Any]
Table = Iterator[tuple[str, Callable[[], Figures]]]


def session_figures(split: Split, settings: SessionSettings) -> Figures:
    """Play a session for each person and condition, and score them together."""
    played = [
        judge(session, play(frames_of(session.counts), model))
        for model, own in split
        for session in sessions(own, settings)
    ]
    return msgspec.structs.asdict(score(played))


def passing_figures(split: Split) -> Figures:
    """Score the touches of a visitor; see `passing.MIXED`."""
    fates = [fate for model, own in split for fate in passing.measure(own, model)]
    return msgspec.structs.asdict(passing.score([fate for fate in fates if fate.touch.is_in_mix]))


def delay_figures(split: Split) -> Figures:
    """Return how long after the first visible pressure a touch is reported, with the rest levelled."""
    return delays(
        (case, play(frames_of(case_counts(case)), model))
        for model, own in split
        for case in spliced(own, level_rest=True)
    )


def case_counts(case: Case) -> Counts:
    """Return what the pad reads until the gesture ends."""
    counts: Counts = np.clip(np.rint(case.scans[: case.stop]), 0, MAX_COUNT).astype(np.uint16)
    return counts


def delays(cases: Iterable[tuple[Case, Sequence[Event]]]) -> Figures:
    """Return the figures of these cases together."""
    delays_ms: list[float] = []
    missed = touches = 0
    for case, events in cases:
        touches += 1
        began = [epoch_s(event.time) for event in events if isinstance(event, TouchBegan)]
        found = [at_s for at_s in began if at_s * FRAME_RATE_HZ >= case.start]
        missed += not found
        if found:
            visible_s = (case.visible_at or case.start) / FRAME_RATE_HZ
            delays_ms.append(max(0.0, 1000.0 * (found[0] - visible_s)))
    median, most = np.quantile(delays_ms, [0.5, 0.9])
    return {
        "touches": touches,
        "missed": missed,
        "late": sum(ms > 1000.0 for ms in delays_ms),
        "median_ms": round(float(median), 1),
        "p90_ms": round(float(most), 1),
    }


def false_in_10_min(split: Split, played: Callable[[Iterable[Frame], Classifier], list[Event]]) -> float:
    """Return the false touches in ten minutes of notouch on a noisier pad. played: the events of frames."""
    rng, began, minutes = np.random.default_rng(0), 0, 0.0
    for model, recordings in split:
        for scans in (one.counts for one in recordings if one.gesture == NO_TOUCH):
            noisy = (scans + NOISE_COUNTS * rng.normal(size=scans.shape)).clip(0).round()
            events = played(frames_of(noisy.astype(np.uint16)), model)
            began += sum(isinstance(event, TouchBegan) for event in events)
            minutes += len(scans) / FRAME_RATE_HZ / 60.0
    return round(10.0 * began / minutes, 2)


class Tables:
    """The recordings, the networks that never saw their people, and what is measured on them."""

    def __init__(self, folders: Any) -> None:
        weights = folders.weights
        self._third, self._firm = folders.third_study, folders.firm_pad
        self._shipped = Classifier.load(weights / SHIPPED_MODEL.name)
        self._fabric = Classifier.load(weights / FABRIC_MODEL.name)
        training = haart.realigned(haart.read_training(folders.haart))
        robot = second_study.read(folders.second_study)
        self._training = training
        self._test: Split = [(self._shipped, haart.realigned(haart.read_test(folders.haart)))]
        self._haart = left_out_split(weights, training)
        self._robot = left_out_split(weights, robot)
        self._second = left_out_split(weights, second_study.scored(robot))
        self._third_recordings = left_out_split(weights, third_study.read(folders.third_study))

    def all(self) -> Table:
        """Yield each row's name and what measures it."""
        plain = SessionSettings()
        of_robot = {
            substrate: [
                (model, [one for one in own if one.substrate == substrate]) for model, own in self._robot
            ]
            for substrate in ("static", "dynamic")
        }
        yield "sessions/HAART test", partial(session_figures, self._test, plain)
        yield "sessions/HAART", partial(session_figures, self._haart, plain)
        yield "sessions/robot still", partial(session_figures, of_robot["static"], plain)
        yield "sessions/robot breathes", partial(session_figures, of_robot["dynamic"], plain)
        for rest, name in ((0, "held out"), (60, "held out, rests at 60")):
            yield f"streams/{name}", partial(self._streams, None, rest)
        yield "streams/never met", partial(self._streams, self._fabric, 0)
        if self._firm is not None:
            for hz, rate_hz in FIRM_RATES:
                yield f"firm pad/{hz:g} Hz sent at {rate_hz:g}", partial(self._firm_pad, hz, rate_hz)
        splits = {
            "HAART test": self._test,
            "HAART": self._haart,
            "second study": self._second,
            "third study": self._third_recordings,
        }
        for name, split in splits.items():
            yield f"passing/{name}", partial(passing_figures, split)
        yield "found after/HAART test", partial(delay_figures, self._test)
        yield "found after/HAART", partial(delay_figures, self._haart)
        yield "noise of one count/HAART", self._false
        for name, settings in DISTURBED.items():
            yield f"{name}/HAART test", partial(session_figures, self._test, settings)
            yield f"{name}/HAART", partial(session_figures, self._haart, settings)
        for name in ("HAART test", "HAART", "second study"):
            yield f"changes/{name}", partial(self._changes, splits[name])

    def _false(self) -> Figures:
        return {"false_in_10_min": false_in_10_min([(self._shipped, self._training)], play)}

    def _streams(self, model: Classifier | None, rest: int) -> Figures:
        return msgspec.structs.asdict(streams.measure(self._third, model or streams.held_out(), rest))

    def _firm_pad(self, hz: float, rate_hz: float) -> Figures:
        return msgspec.structs.asdict(firm_pad.measure(self._firm, self._shipped, hz, rate_hz))

    @staticmethod
    def _changes(split: Split) -> Figures:
        return msgspec.structs.asdict(changes.measure(split))


def differences(now: Results, before: Results) -> Iterator[str]:
    """Yield a line for each row of which a figure differs."""
    for key in now.find():
        if before.has(key):
            old, new = before.get(key), now.get(key)
            changed = [
                f"{name} {old[name]} -> {new[name]}" for name in new if name in old and old[name] != new[name]
            ]
            if changed:
                yield f"{key}: {', '.join(changed)}"


def main(arguments: Sequence[str]) -> int:
    """Measure what is not stored yet, print what differs; returns 0."""
    takes = ("haart", "second-study", "third-study")
    parser = study_parser("tables", "Measures every figure of detection and of what is said in use.", *takes)
    parser.add_argument("--firm-pad", type=Path, help="folder of the firm pad's recordings")
    parser.add_argument(
        "--weights", type=Path, default=SHIPPED_MODEL.parent, help="folder of the model files"
    )
    parser.add_argument("--out", type=Path, default=STORED / "tables.json", help="where to store them")
    parser.add_argument("--against", type=Path, help="an older file to compare with")
    parser.add_argument("--only", default="", help="rows whose names begin with this")
    chosen = parser.parse_args(arguments)
    # The daemon's log would report on every session.
    logging.disable()
    results = Results(chosen.out)
    results.measure(row for row in Tables(chosen).all() if row[0].startswith(chosen.only))
    if chosen.against is not None:
        sys.stdout.writelines(f"{line}\n" for line in differences(results, Results(chosen.against)))
    return 0
