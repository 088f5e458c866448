"""The result of one check."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal

from touchd.drivers.errors import one_line

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

    def __post_init__(self) -> None:
        # It may contain a robot's answer, which may span lines.
        object.__setattr__(self, "found", one_line(self.found))
