"""Events in words, for people at a terminal."""

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
from touchd.daemon.setup.words import Language, Vocabulary, name_of
from touchd.daemon.terminal.terms import term
from touchd.drivers.frame import FRAME_RATE_HZ


def describe(event: Event, words: Vocabulary, language: Language = "en") -> str:
    match event:
        case TouchBegan():
            return term(language, "begins", number=event.touch)
        case Prediction():
            after, told = term(language, "after"), term(language, "told")
            # The confidence is the likeliest gesture's, not that of being unsure.
            sure = "" if event.gesture == UNCERTAIN else f"{event.confidence:4.0%}"
            return (
                f"  {term(language, event.stage):<9} {after} {event.elapsed_s:4.1f} s: "
                f"{name_of(words, event.gesture):<10} {sure:4}  in {event.latency_ms:.1f} ms"
                f"{f'  {told}' if event.told else ''}"
            )
        case TouchEnded():
            length = f"{event.frames / FRAME_RATE_HZ:.1f}"
            ending = "" if event.reason == "released" else term(language, event.reason)
            name = name_of(words, event.gesture)
            return term(language, "ends", number=event.touch, name=name, length=length) + ending
        case SensorEvent() | RobotEvent():
            what = "pad" if isinstance(event, SensorEvent) else "robot"
            reason = f" ({event.reason})" if event.reason else ""
            return f"{term(language, what)} {term(language, event.state)}{reason}"
        case RobotAction(action="say" | "animated_say"):
            return term(language, "says", what=term(language, "quote", what=event.what))
        case RobotAction():
            return term(language, "does", what=event.what, action=event.action)
