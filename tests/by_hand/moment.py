"""The demo's recording through the real pipeline, up to the moment that the pictures show."""

import time
from collections.abc import Callable

from daemon.commands.demo import actions_in
from daemon.config import Settings
from daemon.events import Event, LivePrediction, Prediction, RobotAction, TouchBegan, timestamp
from daemon.pipeline import Clock, Pipeline
from daemon.playback.stream import DEMO_RECORDING
from daemon.setup.parts import load_model
from drivers.frame import Frame
from drivers.recording import read_recordings, splice
from drivers.robot.actions import spoken
from drivers.robot.message import RobotMessage
from drivers.robot.reactions import Reactions

# The third touch, a rub, after its final answer.
TOUCH, AFTER_S = 3, 3.1


def play(
    settings: Settings,
    put: Callable[[Event], None],
    put_live: Callable[[LivePrediction], None],
    put_frame: Callable[[Frame], None],
) -> Frame:
    """Hand over all events and frames up to the moment, as fast as possible; returns its frame."""
    stream = splice(read_recordings(DEMO_RECORDING))
    reactions = Reactions(actions_in(settings.language))
    began_ms: list[int] = []

    def emit(event: Event) -> None:
        put(event)
        if isinstance(event, TouchBegan) and event.touch == TOUCH:
            began_ms.append(event.sensor_ms)
        if not isinstance(event, Prediction):
            return
        answer = RobotMessage(event.gesture, event.confidence, 0.0, event.stage, event.touch, 0)
        reaction = reactions.choose(answer, time.monotonic(), is_told=event.told)
        for action in reaction.actions if reaction else ():
            if template := action.say or action.animated_say:
                words = spoken(template, event.gesture, event.confidence, settings.vocabulary)
                put(RobotAction(touch=event.touch, action="say", what=words, time=timestamp(time.time())))

    # A frame arrives at the sensor's time; real time is added after it, so that latencies are true.
    now_s = came_s = 0.0
    clock = Clock(monotonic_s=lambda: now_s + time.monotonic() - came_s)
    pipeline = Pipeline(settings.pipeline, load_model(settings), emit, clock, viewers=lambda: [put_live])
    for number, (sensor_ms, counts) in enumerate(zip(stream.sensor_ms.tolist(), stream.counts, strict=True)):
        now_s = sensor_ms / 1000
        frame = Frame(number, sensor_ms, now_s, counts)
        put_frame(frame)
        came_s = time.monotonic()
        pipeline.on_frame(frame)
        if began_ms and sensor_ms - began_ms[0] >= 1000 * AFTER_S:
            return frame
    raise RuntimeError(f"{DEMO_RECORDING} has no touch {TOUCH} of {AFTER_S} s")
