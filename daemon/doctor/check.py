"""The result of one check."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal

Verdict = Literal["ok", "warning", "to do", "not checked"]


@dataclass(frozen=True)
class Check:
    """The result of one check. found: in words for the user.

    verdict: "ok"; "warning" (touchd copes); "to do" (does not work, or not well, until `advice` is
    followed); "not checked" (`found` says why).
    figures: measurements; names carry units.
    """

    name: str
    verdict: Verdict
    found: str
    advice: str = ""
    figures: Mapping[str, float] = field(default_factory=dict)
