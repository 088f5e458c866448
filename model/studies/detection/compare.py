"""How well the detector finds touches: `python -m touchd.model.studies detection`.

The sessions, streams and the firm pad of `tables`, with the learned tracker alone; its rows have the same
names, so that `tables --against` compares it with the daemon's rules.
"""

import logging
import sys
from collections.abc import Callable, Iterable, Iterator, Sequence
from functools import partial
from pathlib import Path
from time import monotonic
from typing import Any

import msgspec

from touchd.daemon.path.events import Event, TouchBegan, TouchEnded, timestamp
from touchd.daemon.path.pipeline import question_of
from touchd.daemon.path.tracker import Onset, Question, Release, TouchSettings, TouchTracker
from touchd.drivers.frame import Frame
from touchd.drivers.pad.grid import Ring
from touchd.drivers.recording import Recording
from touchd.model.classifier import SHIPPED_MODEL, Classifier
from touchd.model.detector import SHIPPED_DETECTOR, Detector
from touchd.model.studies.detection.cases import spliced
from touchd.model.studies.folders import study_parser
from touchd.model.studies.play import frames_of
from touchd.model.studies.results import STORED, Results
from touchd.model.studies.sessions import firm_pad, streams
from touchd.model.studies.sessions.plan import SessionSettings, sessions
from touchd.model.studies.sessions.score import judge, score
from touchd.model.studies.tables import DISTURBED, FIRM_RATES, case_counts, delays
from touchd.model.training import haart, second_study

FILE = STORED / "detection.json"
FIGURES = ("missed", "merged", "split", "open", "false", "n")
HISTORY_FRAMES = 1500
Figures = dict[str, Any]


def detect(
    frames: Iterable[Frame],
    detector: Detector,
    question: Question | None,
    settings: TouchSettings | None = None,
    *,
    is_finer: bool = False,
    flush: bool = False,
) -> list[Event]:
    """Return where touches begin and end; their times are the frames'. flush: end what still goes on."""
    ring, tracker = (
        Ring(HISTORY_FRAMES),
        TouchTracker(settings or TouchSettings(), detector, question, is_finer=is_finer),
    )
    events: list[Event] = []
    number, now_s = 0, 0.0

    def ended(release: Release) -> TouchEnded:
        (last,) = ring.frames(release.last_index, release.last_index + 1)
        return TouchEnded(
            touch=number,
            gesture="",
            frames=release.last_index + 1 - release.first_index,
            reason=release.reason,
            time=timestamp(now_s),
            sensor_ms=round(last.sensor_ms),
        )

    for frame in frames:
        now_s = frame.host_s
        for laid in ring.push(frame):
            match tracker.update(laid):
                case Onset(first_index):
                    number += 1
                    (at,) = ring.frames(first_index, first_index + 1)
                    events.append(
                        TouchBegan(touch=number, time=timestamp(now_s), sensor_ms=round(at.sensor_ms))
                    )
                case Release() as release:
                    events.append(ended(release))
    left_open = tracker.forget("stopped") if flush else None
    if left_open is not None:
        events.append(ended(left_open))
    return events


class Comparison:
    """What is measured with one detector; people: whom it never saw, of the studies' training people."""

    def __init__(self, folders: Any, detector: Detector, people: Sequence[str]) -> None:
        self._folders, self._people = folders, people
        self._detect = partial(
            detect, detector=detector, question=question_of(Classifier.load(SHIPPED_MODEL))
        )

    def all(self) -> Iterator[tuple[str, Callable[[], Figures]]]:
        """Yield each row's name and what measures it."""
        folders = self._folders
        if not self._people:
            test = haart.realigned(haart.read_test(folders.haart))
            yield "sessions/HAART test", partial(self._sessions, test, SessionSettings())
            yield "found after/HAART test", partial(self._found, test)
            for name, settings in DISTURBED.items():
                yield f"{name}/HAART test", partial(self._sessions, test, settings)
            if folders.firm_pad is not None:
                for hz, rate_hz in FIRM_RATES:
                    yield f"firm pad/{hz:g} Hz sent at {rate_hz:g}", partial(self._firm_pad, hz, rate_hz)
            return
        own = haart.only(haart.realigned(haart.read_training(folders.haart)), self._people)
        yield "sessions/HAART", partial(self._sessions, own, SessionSettings())
        yield "found after/HAART", partial(self._found, own)
        robot = haart.only(second_study.read(folders.second_study), self._people)
        for words, substrate in (("robot still", "static"), ("robot breathes", "dynamic")):
            some = [one for one in robot if one.substrate == substrate]
            yield f"sessions/{words}", partial(self._sessions, some, SessionSettings())
        yield "streams/held out", self._streams

    def _sessions(self, recordings: Sequence[Recording], settings: SessionSettings) -> Figures:
        played = [
            judge(session, self._detect(frames_of(session.counts)))
            for session in sessions(recordings, settings)
        ]
        result = score(played)
        return {name: getattr(result, name) for name in FIGURES}

    def _found(self, recordings: Sequence[Recording]) -> Figures:
        return delays(
            (case, self._detect(frames_of(case_counts(case))))
            for case in spliced(recordings, level_rest=True)
        )

    def _streams(self) -> Figures:
        own = [
            stream for stream in streams.read(self._folders.third_study) if stream.participant in self._people
        ]
        played = [(stream, self._detect(streams.frames_of(stream), flush=True)) for stream in own]
        result = msgspec.structs.asdict(streams.score(played))
        return {name: result[name] for name in ("touched", "missed", "several", "rest", "false")}

    def _firm_pad(self, hz: float, rate_hz: float) -> Figures:
        scores = [
            firm_pad.score(each, self._detect(firm_pad.frames_of(each, hz, rate_hz), is_finer=True), hz)
            for each in firm_pad.read(self._folders.firm_pad)
        ]
        return msgspec.structs.asdict(firm_pad.together(scores))


def main(arguments: Sequence[str]) -> int:
    """Measure what is not stored yet; returns 0."""
    takes = ("haart", "second-study", "third-study")
    parser = study_parser("detection", "Measures touches detected by a network.", *takes)
    parser.add_argument("--firm-pad", type=Path, help="folder of the firm pad's recordings")
    parser.add_argument("--out", type=Path, default=FILE, help="where to store the figures")
    chosen = parser.parse_args(arguments)
    logging.disable()
    results = Results(chosen.out)
    for path in sorted(SHIPPED_DETECTOR.parent.glob("*.onnx")):
        detector = Detector.load(path)
        for name, measure in Comparison(chosen, detector, sorted(detector.training["left_out"])).all():
            key = f"{path.stem}/{name}"
            if not results.has(key):
                since = monotonic()
                results.put(key, measure(), monotonic() - since)
                sys.stderr.write(f"{key}: {msgspec.json.encode(results.get(key)).decode()}\n")
    return 0
