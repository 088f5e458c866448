"""History: the sensor's frames laid on the model's 54 Hz grid by the sensor's own clock."""

from __future__ import annotations

from typing import Annotated

import msgspec


class RingSettings(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """How lost frames are treated.

    max_gap_s: lost frames are bridged by interpolation up to this long (the touch is marked degraded);
        a longer gap ends the touch. Seconds.
    """

    max_gap_s: Annotated[float, msgspec.Meta(ge=0.05, le=1.0)] = 0.15
