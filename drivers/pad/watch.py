"""Logs a pad's faults: a warning when one begins, a line when it is over, and no flood."""

import logging
import math

from touchd.drivers.frame import DEFAULT_PAD, Frame
from touchd.drivers.pad.health import Kind, PadHealth

log = logging.getLogger(__name__)

# A fault that is back this soon is the same one, a loose wire: logged again only when it lasts.
SAME_TROUBLE_S = 600.0
LASTS_S = 60.0


class PadWatch:
    """Watches the frames for a pad that is broken (see `touchd.drivers.pad.health`) and logs what it finds.

    name: the pad's, logged with it.
    """

    def __init__(self, name: str = DEFAULT_PAD) -> None:
        self._prefix = "" if name == DEFAULT_PAD else f"{name}: "
        self._health = PadHealth()
        self._warned_s: dict[Kind, float] = {}
        self._unsaid: dict[Kind, tuple[float, str]] = {}

    def update(self, frame: Frame) -> None:
        now_s, finding = frame.host_s, self._health.update(frame)
        if finding is not None and finding.began:
            is_same = now_s - self._warned_s.get(finding.kind, -math.inf) < SAME_TROUBLE_S
            self._unsaid[finding.kind] = (now_s + LASTS_S if is_same else -math.inf, finding.what)
        elif finding is not None and self._unsaid.pop(finding.kind, None) is None:
            log.info("%sno longer: %s", self._prefix, finding.what)
        for kind, (from_s, what) in tuple(self._unsaid.items()):
            if now_s > from_s:
                del self._unsaid[kind]
                self._warned_s[kind] = now_s
                log.warning("%s%s", self._prefix, what)
