"""Events in words, for people at a terminal."""

from collections.abc import Mapping

from touchd.daemon.path.events import (
    UNCERTAIN,
    EndReason,
    Event,
    Label,
    Prediction,
    RobotAction,
    RobotEvent,
    SensorEvent,
    TouchBegan,
    TouchEnded,
)
from touchd.daemon.robot.words import Vocabulary, name_of
from touchd.drivers.frame import FRAME_RATE_HZ

ENDINGS: Mapping[EndReason, str] = {
    "gap": ", too many frames were lost",
    "longest": ", longer than a touch may last",
    "sensor": ", the pad went down",
    "settled": ", taken for the pad's new rest",
    "stopped": ", reading stopped",
}


def confidence_of(answer: Prediction) -> str:
    """Return an answer's confidence; "" if it is unsure, as then it is the likeliest gesture's."""
    return "" if answer.gesture == UNCERTAIN else f"{answer.confidence:.0%}"


def describe(event: Event, words: Vocabulary) -> str:
    match event:
        case TouchBegan():
            return f"touch {event.touch} begins"
        case Prediction():
            return (
                f"  {event.stage:<9} after {event.elapsed_s:4.1f} s: "
                f"{name_of(words, event.gesture):<10} {confidence_of(event):>4}  in {event.latency_ms:.1f} ms"
                f"{'  told' if event.told else ''}"
            )
        case TouchEnded():
            name, length_s = name_of(words, event.gesture), event.frames / FRAME_RATE_HZ
            return f"touch {event.touch} ends: {name}, {length_s:.1f} s{ENDINGS.get(event.reason, '')}"
        case SensorEvent() | RobotEvent():
            what = "pad" if isinstance(event, SensorEvent) else "robot"
            return f"{what} {event.state}{f' ({event.reason})' if event.reason else ''}"
        case RobotAction(action="say" | "animated_say"):
            return f"robot says “{event.what}”"
        case Label():
            return f"touch {event.touch} was: {name_of(words, event.gesture)}"
        case RobotAction():
            return f"robot does {event.what} ({event.action})"
