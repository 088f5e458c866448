"""Removes vibration of the whole pad, such as mains hum or a motor, from the frames on the grid.

A hand changes some taxels, each by a different amount. Hum changes all taxels equally, a motor all of them by
similar amounts. Sampled at 54 Hz, either is one sine; hum appears at 4 Hz. If all taxels follow a sine, this
learns its frequency, its phase and each taxel's weight, and subtracts it from every frame. It goes on under a
hand, because the taxels that the hand does not touch still show the sine. Frames of a pad that does not
vibrate pass unchanged.

The constants were chosen on HAART's and the second study's sessions under hum and motors (docs/sessions.md).
"""

import cmath
from collections import deque
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from touchd.drivers.frame import FRAME_RATE_HZ, MAX_COUNT

Pressures = NDArray[np.float32]

# Fit a sine to the last two thirds of a second, six times a second.
STRIDE_FRAMES = 9
WINDOW_FRAMES = 36
# Least amplitude of a vibration, in counts. A new one reaches it after about 20 frames. Of 802 recordings of
# touches and rest, one reaches it: its pad shakes.
LEAST_COUNTS = 0.5
# Least share of the variance of the pad's mean that the sine explains.
LEAST_EXPLAINED = 0.5
# All taxels follow a vibration: the lower quartile of their weights reaches this share of the upper decile.
QUARTER_SHARE = 0.4
# On an untouched pad, a fit whose phase differs by more is another vibration, and is learned at once. Under a
# hand, it is due to the hand or to a step of the rest, and is ignored.
LIKE_RADIANS = 0.4
# Weights, phase and frequency move towards a new fit by this share.
LEARNED = 0.3
# If subtracting the sine quadruples the variance of half a window, the vibration has ended.
ENDED = 4.0
# Weights are learned from frames in which the sine is positive. If its period takes two to four frames, these
# may all have the same value: if their variance is below this share of its power, all frames are used.
SAME_SHARE = 0.03

AGO = np.arange(1 - WINDOW_FRAMES, 1)
HANN = np.hanning(WINDOW_FRAMES + 2)[1:-1]
SLOPE = AGO - AGO.mean()
LEVEL_AND_SLOPE = np.stack([np.ones(WINDOW_FRAMES), SLOPE])
# A maximum at the first or last frequency belongs to a vibration outside the range.
TURNS = 2 * np.pi * np.arange(2.75, 25.26, 0.25) / FRAME_RATE_HZ
WAVES = np.exp(-1j * np.outer(TURNS, AGO)) * HANN * 2 / HANN.sum()


@dataclass
class _Wave:
    """A sine: its turn per frame (radians), its newest value (counts), and each taxel's part in it.

    weights, rest: (64,), the sine's share in each taxel, and its counts without the sine.
    """

    turn: float
    now: complex
    weights: Pressures
    rest: Pressures

    def values(self, ago: NDArray[np.int_]) -> NDArray[np.float32]:
        """Return its values at frames relative to the newest, (0, -1, ...)."""
        values: NDArray[np.float32] = (self.now * np.exp(1j * self.turn * ago)).real.astype(np.float32)
        return values

    def without(self, frames: Pressures, values: NDArray[np.float32]) -> Pressures:
        """Return (T, 64) counts without the sine. Counts of 0 stay, as they may have been clipped."""
        left = np.minimum(np.maximum(frames - values[:, None] * self.weights, 0), MAX_COUNT)
        kept: Pressures = np.where(frames > 0, left, 0)
        return kept

    def fit(self, frames: Pressures) -> complex:
        """Fit the sine to the taxels that no hand presses."""
        follows = self.weights > 0
        # The lowest third by load: a hand seldom covers more than two thirds of the pad.
        light = np.sort((frames - self.rest)[:, follows] / self.weights[follows], axis=1)
        sine = self.turn * AGO
        parts = np.stack([*LEVEL_AND_SLOPE, np.cos(sine), -np.sin(sine)], axis=1)
        *_, real, imaginary = np.linalg.lstsq(parts, light[:, light.shape[1] // 3], rcond=None)[0].tolist()
        return complex(real, imaginary)


class Vibration:
    """Follows a pad's frames on the grid and returns them without vibration."""

    def __init__(self) -> None:
        self._recent = deque[Pressures](maxlen=WINDOW_FRAMES)
        self._taken = 0
        self._wave: _Wave | None = None

    def take_out(self, pressure: Pressures) -> Pressures:
        """Take the next (8, 8) counts; return the same array unless the pad vibrates."""
        self._recent.append(pressure)
        self._taken += 1
        if self._wave is not None:
            self._wave.now *= cmath.exp(1j * self._wave.turn)
        if self._taken >= WINDOW_FRAMES and self._taken % STRIDE_FRAMES == 0:
            self._update(np.array(self._recent).reshape(WINDOW_FRAMES, -1))
        wave = self._wave
        if wave is None:
            return pressure
        return wave.without(pressure.reshape(1, -1), wave.values(AGO[-1:])).reshape(pressure.shape)

    def _update(self, frames: Pressures) -> None:
        """Find, follow or forget a vibration in the last frames (T, 64)."""
        wave = self._wave
        common = frames.mean(axis=1, dtype=np.float64)
        common -= common.mean()
        if wave is None and common @ common < WINDOW_FRAMES * (LEAST_COUNTS / 2) ** 2:
            # The pad is calm.
            return
        found = _find(frames, common)
        # How far the fit's phase is ahead, in radians.
        off = 0.0 if wave is None else cmath.phase(wave.fit(frames) / wave.now)
        if found is not None and (wave is None or abs(off) >= LIKE_RADIANS):
            new = _learn(frames, *found)
            self._wave = new if abs(new.now) >= LEAST_COUNTS else None
        elif wave is not None and _has_ended(wave, frames):
            self._wave = None
        elif wave is not None and abs(off) < LIKE_RADIANS:
            wave.turn += LEARNED * off / WINDOW_FRAMES
            wave.now *= cmath.exp(1j * LEARNED * off)
            if found is not None:
                new = _learn(frames, wave.turn, wave.now)
                wave.weights += LEARNED * (new.weights - wave.weights)
                wave.rest += LEARNED * (new.rest - wave.rest)
                wave.now *= (abs(new.now) / abs(wave.now)) ** LEARNED


def _has_ended(wave: _Wave, frames: Pressures) -> bool:
    """Whether the pad no longer vibrates: subtracting the sine increases the variance of the last frames."""
    half = WINDOW_FRAMES // 2
    newest, values = frames[-half:], wave.values(AGO[-half:])
    left = wave.without(newest, values)
    return bool(left.mean(axis=1).var() > ENDED * newest.mean(axis=1).var())


def _find(frames: Pressures, common: NDArray[np.float64]) -> tuple[float, complex] | None:
    """Return the turn and the newest value of the sine that all taxels follow, if there is one.

    common: (T,), the mean of the taxels, less its mean over time.
    """
    common = common - SLOPE * (SLOPE @ common / (SLOPE @ SLOPE))
    found = WAVES @ common
    at = int(np.abs(found).argmax())
    if at in (0, len(TURNS) - 1):
        return None
    now = complex(found[at])
    explained = HANN.sum() * abs(now) ** 2 / 2
    if abs(now) < LEAST_COUNTS or explained < LEAST_EXPLAINED * float(HANN @ common**2):
        return None
    alive = frames[:, np.ptp(frames, axis=0) > 0]
    following = np.sort((WAVES[at] @ (alive - alive.mean(axis=0)) / now).real)
    if 4 * len(following) < 3 * frames.shape[1]:
        # Ignore taxels that stand still, such as a row with a broken wire, but require that most vary.
        return None
    quarter, high = following[len(following) // 4], following[9 * len(following) // 10]
    return (float(TURNS[at]), now) if quarter >= QUARTER_SHARE * high else None


def _learn(frames: Pressures, turn: float, now: complex) -> _Wave:
    """Learn each taxel's weight from an untouched pad, while the sine is positive: no count is cut at 0."""
    values = (now * np.exp(1j * turn * AGO)).real
    above, upper = values[values > 0], frames[values > 0]
    if above.var() < SAME_SHARE * abs(now) ** 2:
        above, upper = values, frames
    off = above - above.mean()
    slopes = off @ upper / (off @ off)
    # The median slope is 0 if more than half of the taxels are cut off at the top.
    scale = max(float(np.median(slopes)), SAME_SHARE)
    weights = np.where(np.ptp(frames, axis=0) > 0, np.clip(slopes / scale, 0.3, 2.0), 0.0)
    rest = upper.mean(axis=0) - weights * scale * above.mean()
    return _Wave(turn, now * scale, weights.astype(np.float32), rest.astype(np.float32))
