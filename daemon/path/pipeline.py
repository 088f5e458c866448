"""From frames to events: ring, touch tracker, classifier and decision, joined without threads or I/O."""

import itertools
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import TypeAlias

import msgspec
import numpy as np
from numpy.typing import NDArray

from touchd.daemon.path.decide import Decision, DecisionSettings
from touchd.daemon.path.events import (
    MAX_REASON_BYTES,
    UNCERTAIN,
    EndReason,
    Event,
    LivePrediction,
    Prediction,
    SensorEvent,
    Stage,
    TouchBegan,
    TouchEnded,
    timestamp,
)
from touchd.daemon.path.feel import FeelMeter
from touchd.daemon.path.monitor import PadMonitor
from touchd.daemon.path.staleness import Staleness
from touchd.daemon.path.tracker import SETTLED_FRAMES, Onset, Release, TouchSettings, TouchTracker
from touchd.drivers.errors import one_line
from touchd.drivers.frame import CLOCK_MODULUS, DEFAULT_PAD, FRAME_RATE_HZ, NO_TOUCH, Frame, SensorState
from touchd.drivers.pad.grid import GridFrame, Ring
from touchd.model.classifier import Classifier, ModelState, subtract_high_rest
from touchd.model.detector import REST_FRAMES, Detector

STAGES: tuple[Stage, Stage, Stage] = ("early", "revised", "final")
# After the final answer the network is asked about the last 0.8 s alone, three times a second while the hand
# is there. The mean of two such windows shows whether the gesture has changed (docs/sessions.md).
ONGOING_FRAMES, ONGOING_STRIDE_FRAMES = 42, 18
ONGOING_WINDOWS = 2
# The longest lift-off of a pat. An answer that is due after a longer silence waits until contact resumes,
# and then includes the silence (in HAART, 90 % are right instead of 70), or until the touch has ended, and
# then excludes it (80 % instead of 60). The answer to an ended touch includes this many frames after the last
# contact, which show that the hand has left: without them, 11 instead of 33 of 35 single strokes are named.
LIFT_OFF_FRAMES = 13
# An answer that is not sure then waits for half a second without contact. At the touch's end, it would come
# 0.1 to 0.2 s later on average.
UNSURE_FRAMES = 27
SHOWN_STRIDE_FRAMES = 3  # while there are viewers
# Frames per step of the network. A step of nine takes 0.25 ms longer than a step of one, and steps of nine
# take half the processor time of steps of three.
FEED_FRAMES = 9
# Waking up with cold caches costs more than a frame, so three are read at once unless an answer may be due.
# `touch_began` then comes up to 60 ms after the frame that shows it.
TOGETHER_FRAMES = 3

Viewers: TypeAlias = Callable[[], Sequence[Callable[[LivePrediction], None]]]


class PipelineSettings(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Everything between a frame and an event. size_mm: of the 8x8 taxels. is_finer: a pad of more taxels."""

    touch: TouchSettings = TouchSettings()
    decision: DecisionSettings = DecisionSettings()
    size_mm: tuple[float, float] | None = None
    is_finer: bool = False


@dataclass(frozen=True)
class Clock:
    """The host's time. monotonic_s: as in `Frame.host_s`. epoch_s: seconds since 1970, for events."""

    monotonic_s: Callable[[], float] = time.monotonic
    epoch_s: Callable[[], float] = time.time


@dataclass
class Touch:
    """The current touch, of `length` frames so far.

    rest: the counts of the 64 taxels before it. due: the stages still to come, with the length at which each
    is answered. off_frames: since the last contact. answered_release: the length at which the touch was
    answered because the hand had left. outputs: the model's probabilities by length. state: the model's,
    after the touch's first `fed` frames. recent: the model's latest outputs after the final answer.
    next_ongoing: the length at which the next one is due.
    """

    number: int
    first_index: int
    rest: NDArray[np.float32]
    decision: Decision
    due: list[tuple[int, Stage]]
    degraded: bool
    meter: FeelMeter
    next_ongoing: int
    length: int = 0
    off_frames: int = 0
    answered_release: int = 0
    outputs: dict[int, NDArray[np.float64]] = field(default_factory=dict)
    state: ModelState | None = None
    fed: int = 0
    recent: list[NDArray[np.float64]] = field(default_factory=list)

    @property
    def waits_until_sure(self) -> bool:
        """Whether the early answer is still to come, and may come before its mark."""
        return self.decision.may_be_early and bool(self.due) and self.due[0][1] == "early"

    @property
    def is_answer_near(self) -> bool:
        """Whether an answer may be due before the read after the next, which the reader already waits for."""
        marks = [length - self.length for length in (self.next_ongoing, *(mark for mark, _ in self.due))]
        has_left = [frames - self.off_frames for frames in (LIFT_OFF_FRAMES, UNSURE_FRAMES)]
        return self.waits_until_sure or any(0 < left <= 2 * TOGETHER_FRAMES for left in marks + has_left)


class Pipeline:
    """Takes frames and the sensor's states in order, and emits events as they fall due.

    Events depend only on the frames, not on when or how they arrived; their times are the clock's. detector:
    the shipped one if None. viewers: returns the current viewers, to be called with live predictions.
    monitor: decides on the pad's state.
    """

    def __init__(
        self,
        settings: PipelineSettings,
        model: Classifier,
        emit: Callable[[Event], None],
        clock: Clock | None = None,
        pad: str = DEFAULT_PAD,
        viewers: Viewers = tuple,
        monitor: PadMonitor | None = None,
        detector: Detector | None = None,
    ) -> None:
        self._emit = emit
        self._viewers = viewers
        self._pad = pad
        self._clock = clock or Clock()
        self._decision_settings = settings.decision
        self._final_frames = settings.decision.answer_at_frames[-1]
        # When a touch ends, its last frame is already quiet_s old.
        self._stale_s = settings.decision.stale_s + settings.touch.quiet_s
        self._model = model
        self._tracker = tracker_of(settings, model, detector or Detector.load())
        # The longest window, plus twice the time after which a settled load ends a touch.
        self._ring = Ring(self._final_frames + 2 * SETTLED_FRAMES)
        self._numbers = itertools.count(1)
        self._size_mm = settings.size_mm
        self._touch: Touch | None = None
        self._staleness = Staleness()
        self._monitor = monitor or PadMonitor(pad)

    @property
    def frames_together(self) -> int:
        """How many frames the reader may read at once: one while an answer may be due soon."""
        return 1 if self._touch is not None and self._touch.is_answer_near else TOGETHER_FRAMES

    def on_frame(self, frame: Frame) -> None:
        laid = self._ring.push(frame)
        for grid_frame in laid:
            self._staleness.update(grid_frame)
            self._advance(grid_frame)
        state = self._monitor.on_frame(
            frame,
            restarted=any(grid_frame.restarted for grid_frame in laid),
            is_untouched=self._tracker.is_untouched,
        )
        self._report(state)

    def on_sensor_state(self, state: SensorState) -> None:
        """Take the sensor's state; when it is down, the touch ends and rest is measured again."""
        if state.state == "down":
            self._stop("sensor")
            self._staleness.forget()
        self._report(self._monitor.on_sensor(state))

    def flush(self) -> None:
        """End the ongoing touch, if any: no more frames come."""
        self._stop("stopped")

    def _report(self, state: SensorState | None) -> None:
        if state is not None:
            reason = one_line(state.reason, MAX_REASON_BYTES)
            self._emit(SensorEvent(state=state.state, time=self._now(), reason=reason, pad=self._pad))

    def _advance(self, frame: GridFrame) -> None:
        match self._tracker.update(frame):
            case Onset(first_index):
                self._begin(first_index, frame)
            case Release() as release:
                self._end(release, frame.host_s)
        if self._touch is not None:
            self._touch.length = frame.index + 1 - self._touch.first_index
            longest = max(LIFT_OFF_FRAMES, self._touch.off_frames)
            self._touch.off_frames = frame.index - self._tracker.last_contact_index
            self._touch.degraded |= frame.bridged
            self._touch.meter.add(frame.pressure)
            self._feed(self._touch)
            # Wait in a longer silence; when the hand is detected again, off_frames becomes smaller.
            if self._touch.off_frames <= longest:
                self._answer_what_is_due(self._touch, frame)
            if self._touch.off_frames in (LIFT_OFF_FRAMES, UNSURE_FRAMES):
                self._answer_release(self._touch, frame)
        elif frame.index % REST_FRAMES == 0 and self._tracker.is_untouched:
            self._monitor.on_rest(self._tracker.noise)

    def _stop(self, reason: EndReason) -> None:
        if (release := self._tracker.forget(reason)) is not None:
            self._end(release, self._clock.monotonic_s())
        self._ring.reset()

    def _begin(self, first_index: int, frame: GridFrame) -> None:
        so_far = self._ring.frames(first_index, frame.index + 1)
        self._touch = Touch(
            number=next(self._numbers),
            first_index=first_index,
            rest=self._tracker.rest,
            decision=Decision(self._decision_settings, self._model.labels),
            due=list(zip(self._decision_settings.answer_at_frames, STAGES, strict=True)),
            degraded=any(earlier.bridged for earlier in so_far),
            meter=FeelMeter(self._tracker.rest, self._tracker.noise, self._size_mm),
            next_ongoing=self._final_frames + ONGOING_STRIDE_FRAMES,
        )
        # The caller adds the newest frame, like those that follow.
        for earlier in so_far[:-1]:
            self._touch.meter.add(earlier.pressure)
        sensor_ms = _as_sent(so_far[0])
        self._emit(TouchBegan(touch=self._touch.number, time=self._now(), sensor_ms=sensor_ms, pad=self._pad))

    def _feed(self, touch: Touch) -> None:
        """Give the model the touch's new frames: every few, at marks, and each one until it is sure."""
        length = touch.length
        viewers = self._viewers()
        is_shown = bool(viewers) and length % SHOWN_STRIDE_FRAMES == 0
        # Feed the frame before an answer too, so that only one frame is left when it is due.
        is_at_mark = bool(touch.due) and touch.due[0][0] - length in (0, 1)
        has_left = LIFT_OFF_FRAMES - touch.off_frames in (0, 1)
        is_due = is_at_mark or length - touch.fed >= FEED_FRAMES or has_left
        if length > self._final_frames or not (is_due or is_shown or touch.waits_until_sure):
            return
        window = self._window(touch, length, length - touch.fed)
        probabilities, touch.state = self._model.step(window, touch.state)
        touch.outputs[length], touch.fed = probabilities, length
        if is_shown:
            weighed = touch.decision.weigh(probabilities)
            shown = {label: round(value, 4) for label, value in weighed.items()}
            live = LivePrediction(touch=touch.number, frames=length, probabilities=shown, pad=self._pad)
            for show in viewers:
                show(live)

    def _window(self, touch: Touch, length: int, frames: int) -> NDArray[np.float32]:
        """Return the last `frames` of the touch's first `length`, less the rest before it if that is high."""
        return subtract_high_rest(self._ring.window(touch.first_index + length, frames), touch.rest)

    def _answer_what_is_due(self, touch: Touch, frame: GridFrame) -> None:
        length = touch.length
        output = touch.outputs.get(length)
        if touch.waits_until_sure and output is not None and touch.decision.is_sure(output, length):
            touch.due[0] = (length, "early")
        overdue = [stage for stage in touch.due if stage[0] <= length]
        if overdue:
            touch.due = touch.due[len(overdue) :]
            due_length, stage = overdue[-1]
            self._answer_at(touch, stage, due_length, frame.host_s)
        if length >= touch.next_ongoing:
            touch.next_ongoing = length + ONGOING_STRIDE_FRAMES
            self._answer_ongoing(touch, frame.host_s)

    def _answer_release(self, touch: Touch, frame: GridFrame) -> None:
        """Answer a touch whose hand has left, at first only if it is sure; another contact continues it."""
        seen = touch.length + LIFT_OFF_FRAMES - touch.off_frames
        output = touch.outputs.get(seen) if touch.due and self._age_s(frame.index) <= self._stale_s else None
        is_over = touch.off_frames == UNSURE_FRAMES
        if output is not None and touch.decision.is_sure_of_released(output, is_over=is_over):
            touch.answered_release = seen
            self._answer_at(touch, "released", seen, frame.host_s)

    def _end(self, release: Release, since_s: float) -> None:
        touch, self._touch = self._touch, None
        if touch is None:
            return
        frames = release.last_index + 1 - release.first_index
        seen = min(frames + LIFT_OFF_FRAMES, touch.length)
        if touch.due and touch.answered_release != seen:
            self._answer_at(touch, "released", seen, since_s)
        elif not touch.decision.is_answered:
            self._answer_at(touch, "uncertain", frames, since_s)
        (last,) = self._ring.frames(release.last_index, release.last_index + 1)
        self._emit(
            TouchEnded(
                touch=touch.number,
                gesture=touch.decision.told or UNCERTAIN,
                frames=frames,
                reason=release.reason,
                time=self._now(),
                sensor_ms=_as_sent(last),
                pad=self._pad,
                feel=touch.meter.feel(),
            )
        )

    def _answer_at(self, touch: Touch, stage: Stage, length: int, since_s: float) -> None:
        """Answer from the touch's first `length` frames, or the last of them that the model can take."""
        frames = min(length, self._final_frames)
        probabilities = touch.outputs.get(length)
        if probabilities is None:
            probabilities = self._model.probabilities(self._window(touch, length, frames))
        self._answer(touch, stage, probabilities, (frames, length), since_s)

    def _answer_ongoing(self, touch: Touch, since_s: float) -> None:
        """Answer with another gesture once the hand has changed to it."""
        frames = min(ONGOING_FRAMES, self._final_frames)
        counts, rest = self._ring.window(touch.first_index + touch.length, frames), self._tracker.rest
        if _leaves(counts - rest.mean()):
            return
        output = self._model.probabilities(subtract_high_rest(counts, rest))
        touch.recent = [*touch.recent[1 - ONGOING_WINDOWS :], output]
        mean: NDArray[np.float64] = np.mean(touch.recent, axis=0)
        if len(touch.recent) == ONGOING_WINDOWS and touch.decision.has_changed(mean):
            self._answer(touch, "ongoing", mean, (frames, touch.length), since_s)

    def _answer(
        self,
        touch: Touch,
        stage: Stage,
        probabilities: NDArray[np.float64],
        window: tuple[int, int],
        since_s: float,
    ) -> None:
        """Decide on the model's output. window: its length, and the touch's length at its end."""
        frames, length = window
        age_s = self._age_s(touch.first_index + length - 1)
        answer = touch.decision.answer(stage, probabilities, may_tell=age_s <= self._stale_s)
        if stage == "ongoing" and not answer.told:
            return
        self._emit(
            Prediction(
                touch=touch.number,
                stage=answer.stage,
                frames=frames,
                elapsed_s=round(length / FRAME_RATE_HZ, 3),
                gesture=answer.gesture,
                confidence=round(answer.confidence, 4),
                probabilities={label: round(value, 4) for label, value in answer.probabilities.items()},
                changed=answer.changed,
                told=answer.told,
                degraded=touch.degraded,
                latency_ms=round(max(0.0, self._clock.monotonic_s() - since_s) * 1000.0, 3),
                model=self._model.name,
                time=self._now(),
                pad=self._pad,
                age_ms=round(age_s * 1000.0, 1),
                feel=touch.meter.feel(),
                perhaps=answer.perhaps,
            )
        )

    def _age_s(self, index: int) -> float:
        """Return how old a frame of the ring is, by the pad's clock."""
        return self._staleness.age_s(self._ring.frames(index, index + 1)[0], self._clock.monotonic_s())

    def _now(self) -> str:
        return timestamp(self._clock.epoch_s())


def tracker_of(settings: PipelineSettings, model: Classifier, detector: Detector) -> TouchTracker:
    """Return a pad's tracker, which asks the model in doubt if that knows `notouch`."""

    def p_no_touch(frames: NDArray[np.float32], rest: NDArray[np.float32]) -> float:
        return float(model.probabilities(subtract_high_rest(frames, rest))[model.labels.index(NO_TOUCH)])

    question = p_no_touch if NO_TOUCH in model.labels else None
    return TouchTracker(settings.touch, detector, question, is_finer=settings.is_finer)


def _leaves(load: NDArray[np.float32]) -> bool:
    """Whether the hand leaves a soft pad: all six parts of (T, 8, 8) counts fall, to less than half."""
    means = [sixth.mean() for sixth in np.array_split(load, 6)]
    return bool((np.diff(means) < 0).all() and means[-1] < means[0] / 2)


def _as_sent(frame: GridFrame) -> int:
    """Return the sensor's clock at a grid frame as the sensor sends it, 0 to 2^32 - 1 ms."""
    return round(frame.sensor_ms) % CLOCK_MODULUS
