"""Plays frames through the daemon's pipeline, as fast as possible."""

from collections.abc import Iterable, Iterator
from functools import lru_cache

from touchd.daemon.path.events import Event
from touchd.daemon.path.pipeline import Clock, Pipeline, PipelineSettings
from touchd.drivers.frame import Counts, Frame
from touchd.drivers.recording import ideal_clock_ms
from touchd.model.classifier import Classifier
from touchd.model.detector import SHIPPED_DETECTOR, Detector

DETECTORS_FOLDER = SHIPPED_DETECTOR.parent / "detector"
"""The detectors that never saw some people, or the third study's pad."""


def frames_of(counts: Counts) -> Iterator[Frame]:
    """Yield counts (T, 8, 8) as frames of a pad with an ideal clock."""
    for number, ms in enumerate(ideal_clock_ms(len(counts)).tolist()):
        yield Frame(ms, ms / 1000.0, counts[number])


@lru_cache
def detectors() -> tuple[Detector, ...]:
    """Return every detector, the shipped one first."""
    return tuple(Detector.load(path) for path in (SHIPPED_DETECTOR, *sorted(DETECTORS_FOLDER.glob("*.onnx"))))


def detector_for(model: Classifier) -> Detector:
    """Return the detector that never saw whom and what this network never saw."""
    training = model.metadata.training
    people, has_third = set(training.get("left_out", ())), "third" in training.get("studies", ("third",))
    return next(
        each
        for each in detectors()
        if people <= set(each.training["left_out"])
        and has_third == (each.training["left_out_study"] != "third")
    )


def play(frames: Iterable[Frame], model: Classifier, flush: bool = False) -> list[Event]:
    """Return the pipeline's events; its clock shows each frame's arrival time.

    flush: whether to end a touch that still goes on at the last frame.
    """
    events: list[Event] = []
    now_s = 0.0
    clock = Clock(lambda: now_s, lambda: now_s)
    pipeline = Pipeline(PipelineSettings(), model, events.append, clock, detector=detector_for(model))
    for frame in frames:
        now_s = frame.host_s
        pipeline.on_frame(frame)
    if flush:
        pipeline.flush()
    return events
