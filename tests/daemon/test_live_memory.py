"""What the live page is told of what was before it came."""

import msgspec
from rigs.expectations import LENGTHS, answers, stream_of

from daemon.config import Settings
from daemon.events import Prediction, TouchBegan
from daemon.live.memory import PREDICTIONS, TOUCHES, Memory
from daemon.setup.parts import load_model

STREAM = stream_of(LENGTHS)
NOW = "2026-11-20T10:00:00.000Z"


def test_what_is_remembered_for_who_comes_late_is_bounded() -> None:
    model = load_model(Settings())
    memory = Memory((Settings(), model))
    prediction = next(event for event in answers(STREAM, model) if isinstance(event, Prediction))
    for touch in range(1, 3 * TOUCHES):
        memory.put(TouchBegan(touch=touch, time=NOW, sensor_ms=0))
        for _ in range(2 * PREDICTIONS):
            memory.put(msgspec.structs.replace(prediction, touch=touch))
    touches = memory.state("", "pad", ("pad",)).touches
    assert [felt.began.touch for felt in touches] == list(range(2 * TOUCHES, 3 * TOUCHES))
    assert {len(felt.predictions) for felt in touches} == {PREDICTIONS}
