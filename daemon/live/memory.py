"""The state of the live page, for viewers who come later."""

from collections import deque
from typing import TypeAlias

import msgspec

from touchd.daemon.config import Settings
from touchd.daemon.events import (
    UNCERTAIN,
    Event,
    Prediction,
    RobotAction,
    RobotEvent,
    SensorEvent,
    TouchBegan,
    TouchEnded,
)
from touchd.daemon.kept.touches import ReportedTouch
from touchd.daemon.setup.words import name_of
from touchd.drivers.frame import FRAME_RATE_HZ
from touchd.model.classifier import Classifier

# What the page knows of a pad: its settings, as the only pad, and its model.
Scene: TypeAlias = tuple[Settings, Classifier]

TOUCHES = 12
PREDICTIONS = 24


class PageState(msgspec.Struct, frozen=True, kw_only=True, tag_field="type", tag="state"):
    """What a page needs when it connects, or has fallen behind.

    pad: of which of the pads. page: stamp of the page's files; a page with another reloads. labels: in the
    order of the probabilities. answer_at_frames, speak_above, revise_margin: of the scene. model: its name.
    names: of the gestures. action: the robot's latest action on the last touch.
    touches: the last ones, oldest first; an ongoing touch comes last.
    """

    page: str
    pad: str
    pads: tuple[str, ...]
    labels: tuple[str, ...]
    answer_at_frames: tuple[int, ...]
    frame_rate_hz: float
    model: str
    speak_above: float
    revise_margin: float
    names: dict[str, str]
    robot_configured: bool
    action: RobotAction | None
    sensor: SensorEvent | None
    robot: RobotEvent | None
    touches: tuple[ReportedTouch, ...]


class Memory:
    """The last touches of a pad with their answers, and the last state of pad and robot; bounded.

    frames: how many have come.
    """

    def __init__(self, scene: Scene) -> None:
        self.scene = scene
        self.frames = 0
        self._sensor: SensorEvent | None = None
        self._robot: RobotEvent | None = None
        self._action: RobotAction | None = None
        self._touches: deque[ReportedTouch] = deque(maxlen=TOUCHES)

    def put(self, event: Event) -> None:
        """Remember an event, unless its touch began before we listened."""
        match event:
            case SensorEvent():
                self._sensor = event
            case RobotEvent():
                self._robot = event
            case RobotAction():
                self._action = event
            case TouchBegan():
                self._action = None
                self._touches.append(ReportedTouch(event))
            case Prediction() | TouchEnded() if self._touches:
                self._touches[-1].add(event)
                del self._touches[-1].predictions[:-PREDICTIONS]

    def state(self, page: str, pad: str, pads: tuple[str, ...]) -> PageState:
        """Return the whole state. page: stamp of the page's files. pad: the name of this pad."""
        settings, model = self.scene
        scene = settings.scene
        return PageState(
            page=page,
            pad=pad,
            pads=pads,
            labels=model.labels,
            answer_at_frames=scene.answer_at_frames,
            frame_rate_hz=FRAME_RATE_HZ,
            model=model.name,
            speak_above=scene.speak_above,
            revise_margin=scene.revise_margin,
            names={label: name_of(settings.vocabulary, label) for label in (*model.labels, UNCERTAIN)},
            robot_configured=settings.robot is not None,
            action=self._action,
            sensor=self._sensor,
            robot=self._robot if settings.robot else None,
            touches=tuple(self._touches),
        )
