"""How well the detector finds touches: `python -m touchd.model.studies detection`.

The sessions, streams and the firm pad of `tables`, with the tracker alone, in minutes.
"""

import logging
from collections.abc import Callable, Iterable, Iterator, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import msgspec

from touchd.daemon.path.events import Event, TouchBegan, TouchEnded, timestamp
from touchd.daemon.path.pipeline import PipelineSettings, tracker_of
from touchd.daemon.path.tracker import SENSITIVITIES, Onset, Release, TouchSettings
from touchd.drivers.frame import Frame
from touchd.drivers.pad.grid import Ring
from touchd.model.classifier import SHIPPED_MODEL, Classifier
from touchd.model.studies.checks.evaluate import Split
from touchd.model.studies.detection.cases import spliced
from touchd.model.studies.folders import study_parser
from touchd.model.studies.marked import fill, table
from touchd.model.studies.play import detector_for, frames_of
from touchd.model.studies.results import STORED, Results
from touchd.model.studies.sessions import firm_pad, streams
from touchd.model.studies.sessions.plan import SessionSettings, sessions
from touchd.model.studies.sessions.score import judge, score
from touchd.model.studies.tables import DISTURBED, FIRM_RATES, case_counts, delays, false_in_10_min
from touchd.model.training import haart, second_study
from touchd.model.training.weights import FABRIC_MODEL, left_out_split

WEIGHTS = SHIPPED_MODEL.parent
FILE = STORED / "detection.json"
FIGURES = ("missed", "merged", "split", "open", "false", "n")
HISTORY_FRAMES = 1500
Figures = dict[str, Any]


def detect(
    frames: Iterable[Frame],
    model: Classifier,
    settings: TouchSettings | None = None,
    *,
    is_finer: bool = False,
    flush: bool = False,
) -> list[Event]:
    """Return where touches begin and end; their times are the frames'.

    model: is asked about doubtful touches; the detector saw no more people than it. flush: end what still
    goes on.
    """
    ring = Ring(HISTORY_FRAMES)
    found_by = PipelineSettings(touch=settings or TouchSettings(), is_finer=is_finer)
    tracker = tracker_of(found_by, model, detector_for(model))
    events: list[Event] = []
    number, now_s = 0, 0.0
    for frame in frames:
        now_s = frame.host_s
        for laid in ring.push(frame):
            match tracker.update(laid):
                case Onset(first_index):
                    number += 1
                    at_ms = _sensor_ms(ring, first_index)
                    events.append(TouchBegan(touch=number, time=timestamp(now_s), sensor_ms=at_ms))
                case Release() as release:
                    events.append(_ended(number, release, ring, now_s))
    left_open = tracker.forget("stopped") if flush else None
    if left_open is not None:
        events.append(_ended(number, left_open, ring, now_s))
    return events


def _ended(touch: int, release: Release, ring: Ring, now_s: float) -> TouchEnded:
    return TouchEnded(
        touch=touch,
        gesture="",
        frames=release.last_index + 1 - release.first_index,
        reason=release.reason,
        time=timestamp(now_s),
        sensor_ms=_sensor_ms(ring, release.last_index),
    )


def _sensor_ms(ring: Ring, index: int) -> int:
    (frame,) = ring.frames(index, index + 1)
    return round(frame.sensor_ms)


class Comparison:
    """What is measured. folders: of the recordings. Networks never saw the people, nor the pad never met."""

    def __init__(self, folders: Any) -> None:
        self._folders = folders
        self._shipped = Classifier.load(SHIPPED_MODEL)

    def all(self) -> Iterator[tuple[str, Callable[[], Figures]]]:
        """Yield each row's name and what measures it."""
        folders, plain = self._folders, SessionSettings()
        test: Split = [(self._shipped, haart.realigned(haart.read_test(folders.haart)))]
        own = left_out_split(WEIGHTS, haart.realigned(haart.read_training(folders.haart)))
        robot = second_study.read(folders.second_study)
        yield "sessions/HAART test", partial(self._sessions, test, plain)
        yield "sessions/HAART", partial(self._sessions, own, plain)
        for words, substrate in (("robot still", "static"), ("robot breathes", "dynamic")):
            some = left_out_split(WEIGHTS, [one for one in robot if one.substrate == substrate])
            yield f"sessions/{words}", partial(self._sessions, some, plain)
        yield "found after/HAART test", partial(self._found, test, TouchSettings())
        for level in SENSITIVITIES:
            settings = TouchSettings(sensitivity=level)
            yield f"sensitivity/{level}", partial(self._sensitivity, own, settings)
        for name, disturbance in DISTURBED.items():
            yield f"{name}/HAART", partial(self._sessions, own, disturbance)
        yield "streams/held out", partial(self._streams, streams.held_out())
        yield "streams/never met", partial(self._streams, Classifier.load(FABRIC_MODEL))
        if folders.firm_pad is not None:
            for hz, rate_hz in FIRM_RATES:
                yield f"firm pad/{hz:g} Hz sent at {rate_hz:g}", partial(self._firm_pad, hz, rate_hz)

    def _sessions(self, held: Split, settings: SessionSettings) -> Figures:
        result = score(
            [
                judge(session, detect(frames_of(session.counts), model))
                for model, recordings in held
                for session in sessions(recordings, settings)
            ]
        )
        return {name: getattr(result, name) for name in FIGURES}

    def _found(self, held: Split, settings: TouchSettings) -> Figures:
        return delays(
            (case, detect(frames_of(case_counts(case)), model, settings))
            for model, recordings in held
            for case in spliced(recordings, level_rest=True)
        )

    def _sensitivity(self, held: Split, settings: TouchSettings) -> Figures:
        """Return delays, and the false touches in ten minutes on a pad with one more count of noise."""
        false = false_in_10_min(held, partial(detect, settings=settings))
        return {**self._found(held, settings), "false_with_noise": false}

    def _streams(self, models: dict[str, Classifier] | Classifier) -> Figures:
        played = []
        for stream in streams.read(self._folders.third_study):
            model = models if isinstance(models, Classifier) else models[stream.participant]
            played.append((stream, detect(streams.frames_of(stream), model, flush=True)))
        result = msgspec.structs.asdict(streams.score(played))
        return {name: result[name] for name in ("touched", "missed", "several", "rest", "false")}

    def _firm_pad(self, hz: float, rate_hz: float) -> Figures:
        scores = []
        for each in firm_pad.read(self._folders.firm_pad):
            frames = firm_pad.frames_of(each, hz, rate_hz)
            scores.append(firm_pad.score(each, detect(frames, self._shipped, is_finer=True), hz))
        return msgspec.structs.asdict(firm_pad.together(scores))


def tables(results: Results) -> dict[str, str]:
    """Return the tables of docs/sessions.md."""
    rows = [
        (
            level,
            own["missed"],
            own["late"],
            f"{own['median_ms']:g} / {own['p90_ms']:g}",
            own["false_with_noise"],
        )
        for level in SENSITIVITIES
        for own in [results.get(f"sensitivity/{level}")]
    ]
    headings = (
        "`touch.sensitivity`",
        "missed",
        "over 1 s late",
        "found after, median / p90 ms",
        "false with noise",
    )
    return {"sensitivity": table(headings, rows)}


def main(arguments: Sequence[str]) -> int:
    """Measure what is not stored yet; returns 0."""
    takes = ("haart", "second-study", "third-study", "docs")
    parser = study_parser("detection", "Measures how well touches are detected.", *takes)
    parser.add_argument("--firm-pad", type=Path, help="folder of the firm pad's recordings")
    parser.add_argument("--out", type=Path, default=FILE, help="where to store the figures")
    chosen = parser.parse_args(arguments)
    logging.disable()
    results = Results(chosen.out)
    results.measure(Comparison(chosen).all())
    fill(chosen.docs / "sessions.md", tables(results))
    return 0
