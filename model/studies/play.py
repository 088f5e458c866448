"""Plays frames through the daemon's pipeline, as fast as possible."""

from collections.abc import Iterable, Iterator

from touchd.daemon.path.events import Event
from touchd.daemon.path.pipeline import Clock, Pipeline, PipelineSettings
from touchd.drivers.frame import Counts, Frame
from touchd.drivers.recording import ideal_clock_ms
from touchd.model.classifier import Classifier


def frames_of(counts: Counts) -> Iterator[Frame]:
    """Yield counts (T, 8, 8) as frames of a pad with an ideal clock."""
    for number, ms in enumerate(ideal_clock_ms(len(counts)).tolist()):
        yield Frame(ms, ms / 1000.0, counts[number])


def play(frames: Iterable[Frame], model: Classifier, flush: bool = False) -> list[Event]:
    """Return the pipeline's events; its clock shows each frame's arrival time.

    flush: whether to end a touch that still goes on at the last frame.
    """
    events: list[Event] = []
    now_s = 0.0
    clock = Clock(lambda: now_s, lambda: now_s)
    pipeline = Pipeline(PipelineSettings(), model, events.append, clock)
    for frame in frames:
        now_s = frame.host_s
        pipeline.on_frame(frame)
    if flush:
        pipeline.flush()
    return events
