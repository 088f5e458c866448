"""Checks of what a pad's values show: rest, noise, taxels, orientation."""

from collections.abc import Iterator

import numpy as np
from msgspec.structs import replace
from numpy.typing import NDArray

from touchd.daemon.app.config import Settings
from touchd.daemon.doctor.check import Check, Sample
from touchd.daemon.doctor.hand import PRESSED_COUNTS, TURNS
from touchd.daemon.path.monitor import FAULTS, STILL_S, TaxelFaults, places
from touchd.daemon.path.pipeline import tracker_of
from touchd.daemon.path.tracker import Onset
from touchd.drivers.frame import COLUMNS, MAX_COUNT, ROWS, Frame
from touchd.drivers.pace import pace_of, steps_ms
from touchd.drivers.pad.grid import Ring
from touchd.drivers.search.search import as_yaml
from touchd.model.classifier import KNOWN_REST_COUNTS, Classifier
from touchd.model.detector import Detector

# Mean counts at rest of a pad that needs `invert`; counts of a taxel under a load. In HAART's recordings a
# taxel at rest reads 2.5 counts on average and 28 at most, with a noise of 0.8.
WRONG_WAY_COUNTS = 0.75 * MAX_COUNT
LOADED_COUNTS = 50.0
# How long TaxelFaults needs to distinguish a stuck taxel from a quiet one.
HEALTH_S = STILL_S + 0.5
# Rows and columns of a corner.
CORNER_LINES = {0, 1, 6, 7}

# The most noise that an untouched taxel may have.
MOST_NOISE_COUNTS = 4.0
# The whole pad vibrates if a sine of this amplitude explains this share of the variance of its mean.
LEAST_SINE_COUNTS, EXPLAINED = 0.5, 0.5
# A row or column is loose if its median steps up and down by LEAST_STEP_COUNTS within STEP_FRAMES, and by
# ALONE times as much as most rows and columns.
STEP_FRAMES, LEAST_STEP_COUNTS, ALONE = 12, 2.0, 4.0
# A taxel at its limit; a quarter of the pad there has too heavy a load, or a short.
SATURATED_COUNT = 1000
# A taxel jumps if it reads this much more, or less, than in the frames before and after; values are garbled
# if more than this share of the frames has a jump.
JUMP_COUNTS, GARBLED_SHARE = 100, 0.35
# Share of damaged or clipped frames that is too many.
MANY_SHARE = 0.02


def check_rest(sample: Sample, settings: Settings) -> Check:
    """Report the pad's counts at rest, and whether `invert` is right."""
    level = np.median(sample.counts(), axis=0)
    found = f"{level.mean():.1f} counts a taxel, {level.max():.0f} at most"
    if level.mean() > WRONG_WAY_COUNTS:
        return Check("rest", "to do", f"{found}: upside down", _turned_over(settings))
    # A pad may rest high everywhere and unevenly; an object raises some taxels far above the median.
    lies = level > LOADED_COUNTS + 2 * np.median(level)
    if lies.any():
        advice = "take it off; if nothing does, look for a short there"
        return Check("rest", "to do", f"{found}: something lies on {places(lies)}", advice)
    if level.mean() > KNOWN_REST_COUNTS:
        found += "; what a touch adds to that is recognised"
    return Check("rest", "ok", found)


def check_quiet(sample: Sample, settings: Settings) -> Check:
    """Report whether the daemon would have detected a touch."""
    ring, tracker = Ring(1), tracker_of(settings.pipeline, Classifier.load(), Detector.load())
    laid = (laid for frame in sample.frames for laid in ring.push(frame))
    touches = sum(isinstance(tracker.update(frame), Onset) for frame in laid)
    if touches == 0:
        return Check("quiet", "ok", "no touch was detected while the pad was left alone")
    advice = "if you did not touch it: look for a loose wire with touchd run --view"
    if settings.touch.sensitivity != "low":
        advice += ", or set touch.sensitivity to low"
    return Check("quiet", "to do", f"touches detected while listening: {touches}", advice)


def check_noise(sample: Sample) -> Check:
    """Report the noise between frames, and its cause: hum, a loose line, a taxel. A touch raises it."""
    counts = sample.counts().astype(np.float64)
    noise = np.diff(counts, axis=0).std(axis=0) / np.sqrt(2.0)
    found = f"{np.median(noise):.1f} counts a taxel, {noise.max():.1f} at most"
    loud = noise > MOST_NOISE_COUNTS
    is_loud = loud.sum() > ROWS * COLUMNS // 2
    supply = "try another USB port or supply, and a cable away from motors; connect the grounds"
    wires = "look at the wires and plugs there; light touches are missed until they are mended"
    if hum := _hum(counts, pace_of(sample.frames).rate_hz):
        return Check("noise", "to do" if is_loud else "warning", f"{found}: {hum}", supply)
    if is_loud:
        return Check("noise", "to do", f"{found}: the whole pad is noisy", supply)
    if line := _loose_line(counts):
        return Check("noise", "to do", f"{found}: the values of {line} jump together", wires)
    if loud.any():
        return Check("noise", "to do", f"{found}: noise at {places(loud)}", wires)
    return Check("noise", "ok", found)


def _hum(counts: NDArray[np.float64], rate_hz: float) -> str:
    """Describe a sine in the mean of (T, 8, 8) counts, as mains hum or a motor makes; "" if there is none."""
    mean = counts.mean(axis=(1, 2))
    window = np.hanning(len(mean))
    amplitudes = np.abs(np.fft.rfft((mean - mean.mean()) * window)) * 2 / window.sum()
    # Drift and breathing lie below the fourth spectral line.
    amplitudes[:4] = 0
    at = int(amplitudes.argmax())
    if amplitudes[at] < LEAST_SINE_COUNTS or amplitudes[at] ** 2 / 2 < EXPLAINED * mean.var():
        return ""
    swings = f"all taxels swing together by {amplitudes[at]:.1f} counts, at {at * rate_hz / len(mean):.0f} Hz"
    return f"{swings} as sampled: mains hum, or a motor"


def _loose_line(counts: NDArray[np.float64]) -> str:
    """Name the row or column of (T, 8, 8) counts that jumps up and down while others do not; "" if none."""
    kept = np.cumsum(counts, axis=0)
    smooth = (kept[3:] - kept[:-3]) / 3
    # Most of a line's taxels follow it; a single noisy one is not a line.
    lines = np.concatenate([np.median(smooth, axis=2), np.median(smooth, axis=1)], axis=1)
    steps = lines[STEP_FRAMES:] - lines[:-STEP_FRAMES]
    if not len(steps):
        return ""
    jumps = np.minimum(steps.max(axis=0), -steps.min(axis=0))
    line = int(jumps.argmax())
    if jumps[line] < max(LEAST_STEP_COUNTS, ALONE * float(np.median(jumps))):
        return ""
    return f"row {line + 1}" if line < ROWS else f"column {line - ROWS + 1}"


def check_values(sample: Sample, full_scale: float) -> Iterator[Check]:
    """Report values that no hand makes: at their limit, above full scale, or jumping from frame to frame."""
    counts = sample.counts().astype(np.int64)
    if ((counts >= SATURATED_COUNT).mean(axis=(1, 2)) >= 1 / 4).mean() > 1 / 2:
        advice = "take the load off the pad; if there is none, check format's invert, or look for a short"
        yield Check("values", "to do", "a quarter of the pad or more is at its limit", advice)
    before, now, after = counts[:-2], counts[1:-1], counts[2:]
    there, back = now - before, now - after
    jump = np.where(there * back > 0, np.minimum(np.abs(there), np.abs(back)), 0)
    # A jump of less than half of what the taxel reads before and after is noise under a load.
    is_jump = (jump >= JUMP_COUNTS) & (2 * jump >= np.maximum(before, after))
    if len(jump) and is_jump.any(axis=(1, 2)).mean() > GARBLED_SHARE:
        found = "values jump from frame to frame, as no hand makes them"
        yield Check("values", "to do", found, "is it another format, or a bad line?")
    if sample.clipped > MANY_SHARE:
        found = f"values above full_scale {full_scale:g} are cut to it"
        yield Check("values", "warning", found, "if firm presses do that, set a larger one in sensor.format")


def check_taxels(sample: Sample) -> list[Check]:
    """Report dead and stuck taxels, one check for each kind of fault."""
    listened_s = float(steps_ms(sample.frames).sum()) / 1000
    if listened_s < HEALTH_S:
        short = f"needs frames for {HEALTH_S:g} s; they arrived for {listened_s:.1f} s"
        return [Check("taxels", "not checked", short)]
    if not sample.counts().std(axis=0).any():
        advice = "press all over the pad in touchd run --view: where nothing lights up, it is broken"
        found = "no value changed: the pad is silent at rest, or it hangs"
        return [Check("taxels", "warning", found, advice)]
    taxels = TaxelFaults()
    taxels.update(sample.frames)
    if not taxels.found:
        return [Check("taxels", "ok", f"all {ROWS * COLUMNS} are alive")]
    return [Check("taxels", "to do", what, FAULTS[kind].advice) for kind, what in taxels.found.items()]


def is_pressed(frame: Frame, rest: NDArray[np.float64]) -> bool:
    """Return whether a finger presses a corner of the pad in this frame. rest: (8, 8) counts."""
    above = frame.pressure - rest
    return bool(above.max() >= PRESSED_COUNTS) and {*_place(above)} <= CORNER_LINES


def _place(above: NDArray[np.float64]) -> tuple[int, int]:
    """Return the row and the column, from 0, of the highest of (8, 8) counts."""
    row, column = np.unravel_index(int(above.argmax()), above.shape)
    return int(row), int(column)


def check_orientation(sample: Sample, rest: NDArray[np.float64], settings: Settings) -> Check:
    """Report where a press on the top left corner shows, in the sample's last frame, or that values fall."""
    again = "run touchd doctor again, and press the corner"
    if not sample.frames:
        return Check("orientation", "not checked", "no frames came", again)
    above = sample.counts() - rest
    is_corner = is_pressed(sample.frames[-1], rest)
    row, column = _place(above[-1] if is_corner else above.max(axis=0))
    place = f"at row {row + 1} column {column + 1}"
    if is_corner:
        # As in `init`: clockwise, until this corner is at the top left.
        (turn, _), _ = TURNS[row >= ROWS // 2, column >= COLUMNS // 2]
        advice = f"turn the pad, or add {turn} to sensor.turn; if it is mirrored, swap its plugs instead"
        found = f"the top left corner is {place}"
        return Check("orientation", "to do" if turn else "ok", found, advice if turn else "")
    if -above.min() >= PRESSED_COUNTS:
        found = "the values fall where the pad is pressed: upside down"
        return Check("orientation", "to do", found, _turned_over(settings))
    found = f"pressed elsewhere, {place}" if above.max() >= PRESSED_COUNTS else "no corner was pressed"
    return Check("orientation", "not checked", found, again)


def _turned_over(settings: Settings) -> str:
    """Return the advice for a pad that is read upside down."""
    described = settings.sensor.described
    return f"set under sensor: {as_yaml(replace(described, invert=not described.invert))}"
