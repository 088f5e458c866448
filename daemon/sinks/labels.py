"""Labels: what a touch was, as a person says on the keyboard or the live page."""

import logging
import time
from collections.abc import Callable, Mapping, Sequence

from touchd.daemon.path.events import Event, Label, TouchBegan, timestamp
from touchd.drivers.faults import FaultLog
from touchd.drivers.frame import NO_TOUCH, OTHER

log = logging.getLogger(__name__)

# The keys of the gestures other than notouch, in order.
KEYS = "123456789abcdefghijklmnopqrstuvwxyz"
NO_TOUCH_KEY = "0"


class Labeller:
    """Emits an event for each label. Thread-safe.

    emit: receives the events. gestures: that a touch may have been, by pad. are_saved: whether the frames of
    touches are saved, without which a label cannot train a model; if not, the first label logs that.
    """

    def __init__(
        self, emit: Callable[[Event], None], gestures: Mapping[str, Sequence[str]], *, are_saved: bool
    ) -> None:
        self._emit = emit
        self.gestures = gestures
        self._are_saved = are_saved
        self._faults = FaultLog(log)

    def label(self, touch: TouchBegan, gesture: str) -> None:
        """Emit a label. gesture: one of the touch's pad."""
        now = timestamp(time.time())
        self._emit(Label(touch=touch.touch, began=touch.time, gesture=gesture, time=now, pad=touch.pad))
        if not self._are_saved:
            self._faults.begin("lost", "set journal.keep_touches, so that touchd can learn from labels")


def keys_of(gestures: Sequence[str]) -> dict[str, str]:
    """Return the gesture of each key."""
    # Put "other" last, so that the gestures' keys do not depend on it.
    ordered = sorted((gesture for gesture in gestures if gesture != NO_TOUCH), key=OTHER.__eq__)
    named = dict(zip(KEYS, ordered, strict=False))
    return named | ({NO_TOUCH_KEY: NO_TOUCH} if NO_TOUCH in gestures else {})
