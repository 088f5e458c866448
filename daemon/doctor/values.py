"""Checks of what a pad's values show: rest, noise, taxels, orientation."""

import numpy as np
from numpy.typing import NDArray

from touchd.daemon.app.config import Settings
from touchd.daemon.doctor.check import Check
from touchd.daemon.doctor.listening import Sample
from touchd.daemon.path.monitor import TaxelFaults
from touchd.daemon.path.tracker.baseline import MAX_DEVIATION_COUNTS
from touchd.daemon.path.tracker.tracker import Onset, TouchTracker
from touchd.drivers.frame import COLUMNS, MAX_COUNT, ROWS, Frame
from touchd.drivers.pad.grid import Ring
from touchd.drivers.pad.pace import steps_ms
from touchd.model.classifier import KNOWN_REST_COUNTS

# In HAART's recordings a taxel at rest reads 2.5 counts on average and 28 at most, with a noise of 0.8.
WRONG_WAY_COUNTS = 0.75 * MAX_COUNT
LOADED_COUNTS = 50.0
# How long TaxelFaults needs to distinguish a stuck taxel from a quiet one.
HEALTH_S = 6.0
PRESSED_COUNTS = 40
NAMED_TAXELS = 3

ADVICE_FOR: dict[str, str] = {
    "frozen": "press the reset button of its board; look at the cable between pad and board",
    "dead line": "look at that wire and its plug",
    "stuck taxel": "look at the pad there: a thread that came loose, a short?",
    "saturated": "take the load off the pad; if there is none, look for a short",
}


def check_rest(sample: Sample, settings: Settings) -> Check:
    """Report the pad's counts at rest, and whether `invert` is right."""
    level = np.median(sample.counts(), axis=0)
    figures = {"rest_counts": round(float(level.mean()), 1), "highest_rest_counts": float(level.max())}
    found = f"{level.mean():.1f} counts a taxel, {level.max():.0f} at most"
    if level.mean() > WRONG_WAY_COUNTS:
        return Check("rest", "to do", f"{found}: upside down", _turned_over(settings), figures)
    # A pad may rest high everywhere, and unevenly; an object raises some taxels far above the median.
    lies = level > LOADED_COUNTS + 2 * np.median(level)
    if lies.any():
        where = _places(lies)
        advice = "take it off; if nothing does, look for a short there"
        return Check("rest", "to do", f"{found}: something lies on {where}", advice, figures)
    if level.mean() > KNOWN_REST_COUNTS:
        found += "; what a touch adds to that is recognised"
    return Check("rest", "ok", found, "", figures)


def check_quiet(sample: Sample, settings: Settings) -> Check:
    """Report whether the daemon would have detected a touch."""
    ring, tracker = Ring(1), TouchTracker(settings.touch)
    laid = (laid for frame in sample.frames for laid in ring.push(frame))
    touches = sum(isinstance(tracker.update(frame), Onset) for frame in laid)
    figures = {"touches": float(touches)}
    if touches == 0:
        return Check("quiet", "ok", "no touch was detected while the pad was left alone", "", figures)
    advice = (
        "if you did not touch it: look for a loose wire with touchd run --view, "
        "or raise touch.onset_threshold"
    )
    times = "a touch was" if touches == 1 else f"{touches} touches were"
    return Check("quiet", "to do", f"{times} detected while listening", advice, figures)


def check_noise(sample: Sample) -> Check:
    """Report the noise between frames; a touch during the check raises it."""
    steps = np.diff(sample.counts().astype(np.float64), axis=0)
    noise = steps.std(axis=0) / np.sqrt(2.0)
    usual, highest = float(np.median(noise)), float(noise.max())
    figures = {"noise_counts": round(usual, 2), "highest_noise_counts": round(highest, 2)}
    found = f"{usual:.1f} counts a taxel, {highest:.1f} at most"
    loud = noise > MAX_DEVIATION_COUNTS
    if loud.sum() > ROWS * COLUMNS // 2:
        advice = "try another USB port or supply, and a cable away from motors; connect the grounds"
        return Check("noise", "to do", f"{found}: the whole pad is noisy", advice, figures)
    if loud.any():
        advice = "look at the wires there; light touches are missed until they are mended"
        return Check("noise", "to do", f"{found}: {_places(loud)} is noisy", advice, figures)
    return Check("noise", "ok", found, "", figures)


def check_taxels(sample: Sample) -> list[Check]:
    """Report dead and stuck taxels, one check for each kind of fault."""
    listened_s = float(steps_ms(sample.frames).sum()) / 1000
    if listened_s < HEALTH_S:
        return [
            Check(
                "taxels",
                "not checked",
                f"needs frames for {HEALTH_S:g} s; they arrived for {listened_s:.1f} s",
            )
        ]
    if not sample.counts().std(axis=0).any():
        advice = "press all over the pad in touchd run --view: where nothing lights up, it is broken"
        found = "no value changed: the pad is silent at rest, or it hangs"
        return [Check("taxels", "warning", found, advice)]
    taxels = TaxelFaults()
    for frame in sample.frames:
        taxels.update(frame)
    if not taxels.faults:
        return [Check("taxels", "ok", f"all {ROWS * COLUMNS} are alive")]
    return [Check("taxels", "to do", what, ADVICE_FOR[kind]) for kind, what in taxels.faults.items()]


def is_pressed(frame: Frame, rest: NDArray[np.float64]) -> bool:
    """Return whether a finger presses the pad in this frame. rest: (8, 8) counts."""
    return bool((frame.pressure - rest).max() >= PRESSED_COUNTS)


def check_orientation(sample: Sample, rest: NDArray[np.float64], settings: Settings) -> Check:
    """Report where a press on the top left corner shows, in the sample's last frame, or that values fall."""
    if sample.broke_off:
        return Check("orientation", "to do", sample.broke_off, "try another cable")
    if not sample.frames or not is_pressed(sample.frames[-1], rest):
        if sample.frames and (rest - sample.counts()).max() >= PRESSED_COUNTS:
            found = "the values fall where the pad is pressed: upside down"
            return Check("orientation", "to do", found, _turned_over(settings))
        return Check("orientation", "not checked", "no corner was pressed", "run touchd doctor again")
    pressure = sample.frames[-1].pressure - rest
    row, column = np.unravel_index(int(pressure.argmax()), pressure.shape)
    found = f"the top left corner is at row {row + 1} column {column + 1}"
    if row < ROWS // 2 and column < COLUMNS // 2:
        return Check("orientation", "ok", found)
    if row >= ROWS // 2 and column >= COLUMNS // 2:
        return Check("orientation", "to do", found, "turn the pad by 180 degrees, or add 180 to sensor.turn")
    # As `init` turns it: clockwise, until this corner is at the top left.
    turn = 90 if row >= ROWS // 2 else 270
    advice = f"turn the pad, or add {turn} to sensor.turn; if it is mirrored, swap its plugs instead"
    return Check("orientation", "to do", found, advice)


def _turned_over(settings: Settings) -> str:
    """Return the advice for a pad that is read upside down."""
    return f"set sensor.invert: {str(not settings.sensor.described.invert).lower()}"


def _places(mask: NDArray[np.bool_]) -> str:
    """Name the first few taxels of a mask (8, 8), counted from 1."""
    places = np.argwhere(mask)
    named = ", ".join(f"row {row + 1} column {column + 1}" for row, column in places[:NAMED_TAXELS])
    more = len(places) - NAMED_TAXELS
    return f"{named} and {more} more" if more > 0 else named
