"""Logs a pad's faults: a warning when one begins, a line when it is over, and no flood."""

import logging
import math

from drivers.frame import DEFAULT_PAD, Frame
from drivers.pad.health import Finding, Kind, PadHealth

log = logging.getLogger(__name__)

# A fault that is back this soon is the same one, a loose wire: logged again only when it lasts.
SAME_TROUBLE_S = 600.0
LASTS_S = 60.0


class PadWatch:
    """Watches the frames for a pad that is broken (see `drivers.pad.health`) and logs what it finds.

    name: the pad's, logged with it.
    """

    def __init__(self, name: str = DEFAULT_PAD) -> None:
        self._prefix = "" if name == DEFAULT_PAD else f"{name}: "
        self._health = PadHealth()
        self._warned_s: dict[Kind, float] = {}
        self._unsaid: dict[Kind, tuple[float, str]] = {}

    def update(self, frame: Frame) -> None:
        finding = self._health.update(frame)
        if finding is not None and finding.began:
            self._begin(finding, frame.host_s)
        elif finding is not None and self._unsaid.pop(finding.kind, None) is None:
            log.info("%sno longer: %s", self._prefix, finding.what)
        for kind, (since_s, what) in tuple(self._unsaid.items()):
            if frame.host_s - since_s > LASTS_S:
                del self._unsaid[kind]
                self._warn(kind, what, frame.host_s)

    def _begin(self, finding: Finding, now_s: float) -> None:
        if now_s - self._warned_s.get(finding.kind, -math.inf) < SAME_TROUBLE_S:
            self._unsaid[finding.kind] = (now_s, finding.what)
        else:
            self._warn(finding.kind, finding.what, now_s)

    def _warn(self, kind: Kind, what: str, now_s: float) -> None:
        self._warned_s[kind] = now_s
        log.warning("%s%s", self._prefix, what)
