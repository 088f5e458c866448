"""Plays frames through the daemon's pipeline, or its tracker alone, as fast as possible."""

from collections.abc import Iterable, Iterator
from functools import lru_cache
from typing import Protocol

from touchd.daemon.path.events import Event, TouchBegan, TouchEnded, timestamp
from touchd.daemon.path.pipeline import Clock, Pipeline, PipelineSettings, tracker_of
from touchd.daemon.path.tracker import Onset, Release
from touchd.drivers.frame import Counts, Frame
from touchd.drivers.pad.grid import Ring
from touchd.drivers.recording import ideal_clock_ms
from touchd.model.classifier import Classifier
from touchd.model.detector import SHIPPED_DETECTOR, Detector

DETECTORS_FOLDER = SHIPPED_DETECTOR.parent / "detector"
"""The detectors that never saw some people, or the third study's pad."""
DEFAULT = PipelineSettings()
HISTORY_FRAMES = 1500


class Player(Protocol):
    """The type of `play` and `detect`."""

    def __call__(
        self,
        frames: Iterable[Frame],
        model: Classifier,
        settings: PipelineSettings = ...,
        *,
        flush: bool = ...,
    ) -> list[Event]: ...


def play(
    frames: Iterable[Frame], model: Classifier, settings: PipelineSettings = DEFAULT, *, flush: bool = False
) -> list[Event]:
    """Return the pipeline's events; its clock shows each frame's arrival time.

    flush: whether to end a touch that still goes on at the last frame.
    """
    events: list[Event] = []
    now_s = 0.0
    clock = Clock(lambda: now_s, lambda: now_s)
    pipeline = Pipeline(settings, model, events.append, clock, detector=detector_for(model))
    for frame in frames:
        now_s = frame.host_s
        pipeline.on_frame(frame)
    if flush:
        pipeline.flush()
    return events


def detect(
    frames: Iterable[Frame], model: Classifier, settings: PipelineSettings = DEFAULT, *, flush: bool = False
) -> list[Event]:
    """Return where touches begin and end, with no answers about them, in a fraction of `play`'s time."""
    ring = Ring(HISTORY_FRAMES)
    tracker = tracker_of(settings, model, detector_for(model))
    events: list[Event] = []
    number, now_s = 0, 0.0

    def sensor_ms(index: int) -> int:
        (frame,) = ring.frames(index, index + 1)
        return round(frame.sensor_ms)

    def end(release: Release) -> None:
        events.append(
            TouchEnded(
                touch=number,
                gesture="",
                frames=release.last_index + 1 - release.first_index,
                reason=release.reason,
                time=timestamp(now_s),
                sensor_ms=sensor_ms(release.last_index),
            )
        )

    for frame in frames:
        now_s = frame.host_s
        for laid in ring.push(frame):
            match tracker.update(laid):
                case Onset(first_index):
                    number += 1
                    at_ms = sensor_ms(first_index)
                    events.append(TouchBegan(touch=number, time=timestamp(now_s), sensor_ms=at_ms))
                case Release() as release:
                    end(release)
    left_open = tracker.forget("stopped") if flush else None
    if left_open is not None:
        end(left_open)
    return events


def frames_of(counts: Counts) -> Iterator[Frame]:
    """Yield counts (T, 8, 8) as frames of a pad with an ideal clock."""
    for number, ms in enumerate(ideal_clock_ms(len(counts)).tolist()):
        yield Frame(ms, ms / 1000.0, counts[number])


@lru_cache
def detectors() -> tuple[Detector, ...]:
    """Return every detector, the shipped one first."""
    return tuple(Detector.load(path) for path in (SHIPPED_DETECTOR, *sorted(DETECTORS_FOLDER.glob("*.onnx"))))


def detector_for(model: Classifier) -> Detector:
    """Return the detector that was trained without the people and the study that the network never saw."""
    training = model.metadata.training
    people, has_third = set(training.get("left_out", ())), "third" in training.get("studies", ("third",))
    return next(
        each
        for each in detectors()
        if people <= set(each.training["left_out"])
        and has_third == (each.training["left_out_study"] != "third")
    )
