"""Labels: what a person says that a touch was, from the keyboard or the live page."""

import shlex
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

from touchd.daemon.app.config import Settings
from touchd.daemon.path.events import Event, Label, TouchBegan, timestamp
from touchd.daemon.sinks.touch_store import folder_of
from touchd.drivers.errors import TouchdError
from touchd.drivers.frame import NO_TOUCH, OTHER
from touchd.drivers.installed import program_name
from touchd.model.classifier import Classifier

# The key of each gesture but notouch, in order.
KEYS = "123456789abcdefghijklmnopqrstuvwxyz"
NO_TOUCH_KEY = "0"

# From this many labelled touches on, and at each multiple, it says how to learn from them.
ENOUGH = 10


class LabelError(TouchdError):
    """A label cannot be taken; the message is one line that says why."""


class Labeller:
    """Makes an event of each label, and says how to learn from them once there are enough. Thread-safe.

    emit: receives the events. gestures: that a touch may have been, by pad. folders: of kept touches, by pad,
    without those that keep none.
    """

    def __init__(
        self,
        emit: Callable[[Event], None],
        gestures: Mapping[str, Sequence[str]],
        folders: Mapping[str, Path],
    ) -> None:
        self._emit = emit
        self.gestures = gestures
        self._folders = folders
        self._labelled: dict[str, set[int]] = {pad: set() for pad in gestures}

    def label(self, touch: TouchBegan, gesture: str) -> str:
        """Emit a label; return how to learn from this run's labels if there are enough now, else "".

        Raises LabelError if the pad has no such gesture.
        """
        known = self.gestures[touch.pad]
        if gesture not in known:
            raise LabelError(f"{gesture}: not a gesture of this pad's model; it knows {', '.join(known)}")
        labelled = self._labelled[touch.pad]
        is_new = touch.touch not in labelled
        labelled.add(touch.touch)
        now = timestamp(time.time())
        self._emit(Label(touch=touch.touch, began=touch.time, gesture=gesture, time=now, pad=touch.pad))
        count = len(labelled)
        if not is_new or count % ENOUGH:
            return ""
        folder = self._folders.get(touch.pad)
        if folder is None:
            return f"{count} touches labelled; set journal.keep_touches, so that touchd can learn from them"
        # A gesture that nobody has labelled yet must not be dropped.
        how = f"{program_name()} train --keep-all --extra {shlex.quote(str(folder))}"
        return f"{count} touches labelled; to learn from them: {how}"


def make_labeller(
    settings: Settings, models: Mapping[str, Classifier], emit: Callable[[Event], None]
) -> Labeller:
    """Return what takes labels of touches."""
    journal = settings.journal
    folders = {}
    if journal is not None and journal.keep_touches is not None:
        folders = {name: folder_of(journal.file, name) for name in settings.pads}
    return Labeller(emit, {name: model.labels for name, model in models.items()}, folders)


def keys_of(gestures: Sequence[str]) -> dict[str, str]:
    """Return the gesture of each key."""
    # "other" comes last, so that the gestures' keys do not depend on it.
    ordered = sorted((gesture for gesture in gestures if gesture != NO_TOUCH), key=OTHER.__eq__)
    named = dict(zip(KEYS, ordered, strict=False))
    return named | ({NO_TOUCH_KEY: NO_TOUCH} if NO_TOUCH in gestures else {})
