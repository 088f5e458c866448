"""From frames to events: ring, touch tracker, classifier and decision, joined without threads or I/O."""

from __future__ import annotations

import msgspec

from daemon.decide import DecisionSettings
from daemon.ring import RingSettings
from daemon.touch import TouchSettings


class PipelineSettings(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Everything between a frame and an event."""

    ring: RingSettings = RingSettings()
    touch: TouchSettings = TouchSettings()
    decision: DecisionSettings = DecisionSettings()
