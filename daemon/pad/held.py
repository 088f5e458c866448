"""How a touch that goes on looks over, whatever the pad reads.

A fabric rarely comes back to where it was, and noise may have begun meanwhile. So a touch is over when the
pad shows that nobody touches it: it keeps still far below the touch's own level; or it has become far calmer
than the touch was; or the network sees no touch, several times running. A load that keeps still at the
touch's level is no hand, for a resting hand trembles. The figures behind the numbers are in docs/touch.md.
"""

import numpy as np

from touchd.daemon.pad.baseline import SECOND_FRAMES, TAXELS, Baseline, LastSecond, Taxels
from touchd.daemon.pad.sight import ASK_FRAMES, DOUBT, Sight

# The end is checked nine times a second.
END_STRIDE_FRAMES = 6
# Far below the touch's level: a share of its highest half second, or less contact than a resting hand makes.
LOW_SHARE = 0.35
LOW_COUNTS = 80.0
# A taxel keeps still when its half seconds differ by less than this, its sway, or what its noise explains.
STILL_COUNTS = 0.9
STILL_SWAYS = 1.2
STILL_SPREADS = 0.8
MAX_SPREAD_COUNTS = 4.0
LOAD_NOISE = 0.03
STILL_FRAMES = 36
CALM_FRAMES = 90
# Light contact that keeps still may be a light pat's lift-off, if the network surely sees one, for so long.
LEFT_ANYHOW_FRAMES = 200
# A pad whose rest the network takes for a touch is untouched when it moves hardly more than it did at rest.
RESTFUL = 1.1


class HeldTouch:
    """A touch that goes on.

    first, last: its first frame, and its last with contact. still_frames, calm_frames: how long the pad has
    kept still, and been calm.
    """

    def __init__(self, first: int, last: int) -> None:
        self.first = first
        self.last = last
        self.still_frames = self.calm_frames = 0
        self._level = self._highest_level = self._highest_activity = 0.0
        self._seems_left = False

    def touched(self, index: int, sight: Sight) -> None:
        """Note contact at this frame; after a second without, what the pad looked like meanwhile is over."""
        if index - self.last > SECOND_FRAMES:
            self.still_frames = self.calm_frames = 0
            sight.forget_looks()
        self.last = index

    def look(
        self, index: int, recent: LastSecond, baseline: Baseline, sight: Sight, rest_activity: float
    ) -> None:
        """Look at the last second, and have the network look. rest_activity: the untouched pad's."""
        older, newer = recent.halves()
        change, spread = np.abs(newer - older), recent.spread()
        rise = newer - baseline.counts
        above = rise - baseline.noise_floor
        # By what the lightest quarter rose, the whole pad may have drifted.
        drift = max(float(np.sort(rise)[TAXELS // 4]), 0.0)
        level, undrifted = (float(np.maximum(each, 0).sum()) for each in (above, above - drift))
        activity = float(change.sum() + spread.sum())
        self._level, self._highest_level = level, max(self._highest_level, level)
        self._highest_activity = max(self._highest_activity, activity)
        is_far_below = level <= LOW_SHARE * self._highest_level
        is_low = is_far_below or level <= LOW_COUNTS
        is_calm = is_far_below and activity <= LOW_SHARE * self._highest_activity
        self.calm_frames = self.calm_frames + END_STRIDE_FRAMES if is_calm else 0
        is_restful = sight.is_lost and activity <= RESTFUL * rest_activity
        is_still = _is_still(baseline, change, spread, rise) or (is_low and is_restful)
        self.still_frames = self.still_frames + END_STRIDE_FRAMES if is_still else 0
        self._seems_left = (is_low and self.still_frames >= STILL_FRAMES) or self.calm_frames >= CALM_FRAMES
        may_be_low = undrifted <= max(LOW_SHARE * self._highest_level, LOW_COUNTS)
        may_be_none = may_be_low and (sight.knows_rest or not baseline.is_disturbed)
        if not (is_far_below or self.still_frames or may_be_none):
            sight.forget_looks()
        elif index % ASK_FRAMES == 0:
            sight.look(recent.last(SECOND_FRAMES))

    def is_over(self, recent: LastSecond, sight: Sight) -> bool:
        """Whether nobody touches the pad: not if the network surely sees a light touch."""
        if sight.is_none or not self._seems_left:
            return sight.is_none
        seemed_frames = max(self.still_frames, self.calm_frames)
        is_clear = self._level >= LOW_COUNTS or seemed_frames >= LEFT_ANYHOW_FRAMES
        return is_clear or not sight.sees_touch(recent.last(SECOND_FRAMES), DOUBT)

    def over_since(self, index: int, sight: Sight) -> int:
        """Return the frame since which a released touch has been over; the ring holds no older ones."""
        seemed_frames = max(self.still_frames, self.calm_frames, SECOND_FRAMES if sight.is_none else 0)
        over_frames = min(seemed_frames, LEFT_ANYHOW_FRAMES) + SECOND_FRAMES // 2
        return max(self.first, min(self.last, index - over_frames))


def _is_still(baseline: Baseline, change: Taxels, spread: Taxels, rise: Taxels) -> bool:
    allowed = np.maximum(STILL_SWAYS * baseline.sway, STILL_SPREADS * spread)
    noise = np.maximum(LOAD_NOISE * rise, MAX_SPREAD_COUNTS)
    return bool((change <= np.maximum(allowed, STILL_COUNTS)).all() and (spread <= noise).all())
