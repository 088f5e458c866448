"""A made pad that feeds a tracker, frame by frame."""

from collections.abc import Callable

from rigs.made_pad import MadePad, Scans, nothing

from touchd.daemon.path.pipeline import PipelineSettings, tracker_of
from touchd.daemon.path.tracker import Onset, Release, TouchSettings, TouchTracker
from touchd.drivers.pad.grid import GridFrame
from touchd.model.classifier import Classifier
from touchd.model.detector import Detector


class TrackedPad(MadePad):
    """A made pad that feeds a tracker. p_no_touch: asked instead of the shipped classifier."""

    def __init__(
        self,
        settings: TouchSettings | None = None,
        p_no_touch: Callable[[Scans], float] | None = None,
        detector: Detector | None = None,
        *,
        is_finer: bool = False,
    ) -> None:
        super().__init__()
        found_by = PipelineSettings(touch=settings or TouchSettings(), is_finer=is_finer)
        detector = detector or Detector.load()
        self.tracker = tracker_of(found_by, Classifier.load(), detector)
        if p_no_touch is not None:
            question = lambda frames, rest: p_no_touch(frames)  # noqa: E731
            self.tracker = TouchTracker(found_by.touch, detector, question, is_finer=is_finer)
        self.index = 0
        self.gap_ms = 0.0

    def feel(self, *pressures: Scans | float, restarted: bool = False) -> list[Onset | Release]:
        """Feed scans (T, 8, 8), or seconds of nothing; return the tracker's changes."""
        changes = []
        for pressure in pressures:
            scans = nothing(pressure) if isinstance(pressure, float) else pressure
            for counts in self.counts(scans).astype("float32"):
                sensor_ms = self.index * 1000 / 54 + self.gap_ms
                change = self.tracker.update(GridFrame(self.index, sensor_ms, 0.0, counts, False, restarted))
                changes += [change] if change else []
                self.index += 1
                restarted = False
        return changes

    def touched(self, *pressures: Scans | float) -> tuple[Onset, Release]:
        """Feed pressure that must be exactly one touch; return its beginning and end."""
        onset, release = self.feel(*pressures)
        assert (type(onset), type(release)) == (Onset, Release)
        return onset, release
