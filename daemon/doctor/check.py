"""What the doctor says of one thing it looked at."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal

Verdict = Literal["ok", "warning", "to do", "not checked"]


@dataclass(frozen=True)
class Check:
    """One thing looked at, and what was found, in words for a person.

    verdict: "ok"; "warning" (touchd copes, but it is worth knowing); "to do" (it does not work, or not well,
    until `advice` is followed); "not checked" (`found` says why).
    figures: what was measured, by names that carry their units.
    """

    name: str
    verdict: Verdict
    found: str
    advice: str = ""
    figures: Mapping[str, float] = field(default_factory=dict)
