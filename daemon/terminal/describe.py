"""Events in words, for people at a terminal."""

from __future__ import annotations

from daemon.events import Event, Prediction, RobotEvent, SensorEvent, TouchBegan, TouchEnded
from drivers.frame import FRAME_RATE_HZ

ENDINGS = {
    "released": "",
    "settled": ", taken for the pad's new rest",
    "gap": ", too many frames were lost",
    "sensor": ", the pad went away",
    "stopped": ", the stream ended",
}


def describe(event: Event) -> str:
    """Return the event as one line of at most 78 characters, as long as names and reasons are short."""
    match event:
        case TouchBegan():
            return f"touch {event.touch} begins"
        case Prediction():
            told = "  told" if event.told else ""
            return (
                f"  {event.stage:<9} after {event.elapsed_s:4.1f} s: {event.gesture:<9} "
                f"{event.confidence:4.0%}  in {event.latency_ms:.1f} ms{told}"
            )
        case TouchEnded():
            length_s = event.frames / FRAME_RATE_HZ
            return f"touch {event.touch} ends: {event.gesture}, {length_s:.1f} s{ENDINGS[event.reason]}"
        case SensorEvent():
            return f"pad {event.state}{_because(event.reason)}"
        case RobotEvent():
            return f"robot {event.state}{_because(event.reason)}"


def _because(reason: str) -> str:
    return f" ({reason})" if reason else ""
