"""When a touch begins and when it ends."""

from __future__ import annotations

from typing import Annotated

import msgspec


class TouchSettings(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """How a touch is told from a pad at rest. The defaults were chosen by measurement: docs/touch.md.

    onset_level: how far above rest the pad must rise to begin a touch; lower notices lighter touches and
        raises more false alarms.
    release_level: the touch is quiet while below this.
    quiet_s: a touch ends after this much quiet; longer than the lift-off between two pats. Seconds.
    settled_s: a load that has not changed for this long is taken for the pad's new rest. Seconds.
    """

    onset_level: Annotated[float, msgspec.Meta(gt=0, le=1000)] = 8.0
    release_level: Annotated[float, msgspec.Meta(gt=0, le=1000)] = 4.0
    quiet_s: Annotated[float, msgspec.Meta(ge=0.1, le=5.0)] = 0.6
    settled_s: Annotated[float, msgspec.Meta(ge=10, le=3600)] = 120.0

    def __post_init__(self) -> None:
        if self.release_level > self.onset_level:
            raise ValueError(f"release_level {self.release_level} is above onset_level {self.onset_level}")
