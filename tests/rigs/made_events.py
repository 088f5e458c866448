"""Events made up for tests."""

import logging

from touchd.daemon.path.events import Prediction, TouchBegan

TIME = "2026-11-20T10:00:01.000Z"
# Change a field with msgspec.structs.replace.
PREDICTION = Prediction(
    touch=7,
    stage="early",
    frames=54,
    elapsed_s=1.0,
    gesture="stroke",
    confidence=0.81,
    probabilities={"pat": 0.19, "stroke": 0.81},
    changed=True,
    told=True,
    degraded=False,
    latency_ms=1.9,
    model="touchd-1",
    time=TIME,
)


def touch(number: int, second: int = 0) -> TouchBegan:
    return TouchBegan(touch=number, time=f"2026-11-20T10:00:{second:02}.000Z", sensor_ms=number)


def record(text: str, *arguments: object, line: int = 1, level: int = logging.WARNING) -> logging.LogRecord:
    return logging.LogRecord("library", level, "library.py", line, text, arguments, None)
