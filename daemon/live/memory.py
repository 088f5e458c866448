"""The state of the live page, for viewers who come later."""

from collections import deque

import msgspec

from daemon.events import (
    UNCERTAIN,
    Event,
    Prediction,
    RobotAction,
    RobotEvent,
    SensorEvent,
    TouchBegan,
    TouchEnded,
)
from daemon.live.messages import PageState, PageTouch
from daemon.live.scene import Scene
from daemon.setup.words import name_of
from drivers.frame import FRAME_RATE_HZ

TOUCHES = 12
PREDICTIONS = 24


class Memory:
    """The last touches of a pad with their answers, and the last state of pad and robot; bounded."""

    def __init__(self, scene: Scene) -> None:
        self.scene = scene
        self._sensor: SensorEvent | None = None
        self._robot: RobotEvent | None = None
        self._action: RobotAction | None = None
        self._touches: deque[PageTouch] = deque(maxlen=TOUCHES)

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
                self._touches.append(PageTouch(began=event, predictions=(), ended=None))
            case Prediction() | TouchEnded():
                self._add(event)

    def state(self, page: str, pad: str, pads: tuple[str, ...]) -> PageState:
        """Return the whole state. page: stamp of the page's files. pad: the name of this pad."""
        scene = self.scene
        return PageState(
            page=page,
            pad=pad,
            pads=pads,
            labels=scene.model.labels,
            answer_at_frames=scene.settings.decision.answer_at_frames,
            frame_rate_hz=FRAME_RATE_HZ,
            model=scene.model.name,
            speak_above=scene.settings.decision.speak_above,
            revise_margin=scene.settings.decision.revise_margin,
            language=scene.language,
            names={label: name_of(scene.words, label) for label in (*scene.model.labels, UNCERTAIN)},
            robot_configured=scene.robot_configured,
            action=self._action,
            sensor=self._sensor,
            robot=self._robot if scene.robot_configured else None,
            touches=tuple(self._touches),
        )

    def _add(self, event: Prediction | TouchEnded) -> None:
        if not self._touches or self._touches[-1].began.touch != event.touch:
            return
        felt = self._touches[-1]
        if isinstance(event, TouchEnded):
            self._touches[-1] = msgspec.structs.replace(felt, ended=event)
        else:
            predictions = (*felt.predictions, event)[-PREDICTIONS:]
            self._touches[-1] = msgspec.structs.replace(felt, predictions=predictions)
