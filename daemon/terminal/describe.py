"""Events in words, for people at a terminal."""

from __future__ import annotations

from daemon.events import Event, Prediction, RobotAction, RobotEvent, SensorEvent, TouchBegan, TouchEnded
from daemon.setup.words import Vocabulary, name_of
from drivers.frame import FRAME_RATE_HZ

ENDINGS = {
    "released": "",
    "settled": ", taken for the pad's new rest",
    "longest": ", longer than a touch may last",
    "gap": ", too many frames were lost",
    "sensor": ", the pad went away",
    "stopped": ", the stream ended",
}


def describe(event: Event, words: Vocabulary) -> str:
    """Return the event as one line of at most 78 characters, as long as names and reasons are short."""
    match event:
        case TouchBegan():
            return f"touch {event.touch} begins"
        case Prediction():
            told = "  told" if event.told else ""
            return (
                f"  {event.stage:<9} after {event.elapsed_s:4.1f} s: {name_of(words, event.gesture):<10} "
                f"{event.confidence:4.0%}  in {event.latency_ms:.1f} ms{told}"
            )
        case TouchEnded():
            length_s = event.frames / FRAME_RATE_HZ
            name = name_of(words, event.gesture)
            return f"touch {event.touch} ends: {name}, {length_s:.1f} s{ENDINGS[event.reason]}"
        case SensorEvent():
            return f"pad {event.state}{_because(event.reason)}"
        case RobotEvent():
            return f"robot {event.state}{_because(event.reason)}"
        case RobotAction():
            is_said = event.action in ("say", "animated_say")
            return f'robot says "{event.what}"' if is_said else f"robot does {event.what} ({event.action})"


def _because(reason: str) -> str:
    return f" ({reason})" if reason else ""
