"""Makes the streams in tests/recordings, each by a function: pads, touches and faults.

`rigs.expectations` writes them. Every version of numpy gives the same counts.
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.random import RandomState
from numpy.typing import NDArray

from touchd.drivers.fakes.fabric import NOISE_COUNTS, Fabric
from touchd.drivers.frame import CLOCK_MODULUS, COLUMNS, FRAME_RATE_HZ, MAX_COUNT, ROWS, Counts
from touchd.drivers.recording import ideal_clock_ms
from touchd.model.studies.simulated import pressure

Series = NDArray[np.float64]


class Sent(NamedTuple):
    """What a pad sends: (T, 8, 8) counts, and (T,) its clock."""

    counts: Counts
    sensor_ms: NDArray[np.int64]


STREAMS: dict[str, Callable[[], Sent]] = {}


def stream(made: Callable[[], Sent]) -> Callable[[], Sent]:
    """Register a stream under its function's name; the function's docstring is its title."""
    STREAMS[made.__name__.replace("_", "-")] = made
    return made


def hand(seed: int, *script: tuple[str, float], lead_s: float = 2.5, quiet_s: float = 1.5) -> Series:
    """Return (T, 8, 8) pressure at 54 Hz: rest, the gestures, rest."""
    rng = RandomState(seed)
    steps = (("notouch", lead_s), *script, ("notouch", quiet_s))
    return np.concatenate(
        [pressure(gesture, round(seconds * FRAME_RATE_HZ), rng) for gesture, seconds in steps]
    )


def sent(pressed: Series, seed: int = 1, first_ms: int = 0) -> Sent:
    """Return what the fabric pad sends at 54 Hz."""
    return Sent(Fabric(RandomState(seed)).read(pressed), ideal_clock_ms(len(pressed), first_ms))


def at_rate(pressed: Series, rate_hz: float, seed: int = 1) -> Sent:
    """Return what a fabric pad of another rate sends."""
    count = int(len(pressed) / FRAME_RATE_HZ * rate_hz)
    places = np.minimum(np.arange(count) * FRAME_RATE_HZ / rate_hz, len(pressed) - 1)
    before = places.astype(int)
    after, share = np.minimum(before + 1, len(pressed) - 1), (places - before)[:, None, None]
    between = (1 - share) * pressed[before] + share * pressed[after]
    clock_ms = np.rint(np.arange(count) * 1000 / rate_hz).astype(np.int64)
    return Sent(Fabric(RandomState(seed)).read(between), clock_ms)


def counts_of(values: Series) -> Counts:
    """Return values as a pad's counts."""
    clipped: Counts = np.rint(values).clip(0, MAX_COUNT).astype(np.uint16)
    return clipped


def frames_of(seconds: float) -> int:
    return round(seconds * FRAME_RATE_HZ)


def blob(row: float, column: float, radius: float) -> Series:
    """Return (8, 8) pressure of a round contact, 1 at its centre."""
    rows, columns = np.mgrid[0:ROWS, 0:COLUMNS]
    shape: Series = np.exp(-0.5 * ((rows - row) ** 2 + (columns - column) ** 2) / radius**2)
    return shape


def pressing(shape: Series, force: Series) -> Series:
    """Return (T, 8, 8) pressure of a contact with a force (T,)."""
    return force[:, None, None] * shape


def down_for(seconds: float, lead_s: float = 2.5, quiet_s: float = 2.0, edge_s: float = 0.06) -> Series:
    """Return a force (T,) that is 0, then 1 for some time, then 0, with soft edges."""
    time_s = np.arange(frames_of(lead_s + seconds + quiet_s)) / FRAME_RATE_HZ
    rises, falls = (time_s - lead_s) / edge_s, (lead_s + seconds - time_s) / edge_s
    force: Series = np.minimum(rises, falls).clip(0, 1)
    return force


def nothing(seconds: float) -> Series:
    return np.zeros((frames_of(seconds), ROWS, COLUMNS))


# Pads.


@stream
def pad_25_hz() -> Sent:
    """A pad that sends 25 frames a second is stroked, then patted."""
    return at_rate(hand(1, ("stroke", 3.0), ("notouch", 1.5), ("pat", 3.0)), 25.0)


@stream
def pad_50_hz() -> Sent:
    """A pad that sends 50 frames a second is stroked, then patted."""
    return at_rate(hand(1, ("stroke", 3.0), ("notouch", 1.5), ("pat", 3.0)), 50.0)


@stream
def pad_100_hz() -> Sent:
    """A pad that sends 100 frames a second is rubbed."""
    return at_rate(hand(2, ("rub", 3.0)), 100.0)


@stream
def pad_200_hz() -> Sent:
    """A pad that sends 200 frames a second is patted."""
    return at_rate(hand(3, ("pat", 2.0), lead_s=2.0, quiet_s=1.2), 200.0)


@stream
def pad_54_hz_in_jittering_steps() -> Sent:
    """The pad's clock counts steps of 10 ms, so its frames seem to come unevenly."""
    counts, clock_ms = sent(hand(4, ("scratch", 3.0)))
    return Sent(counts, clock_ms // 10 * 10)


@stream
def pad_silent_at_rest() -> Sent:
    """A pad that sends zeros until it is pressed is stroked."""
    counts, clock_ms = sent(hand(5, ("stroke", 3.2)))
    return Sent(np.where(counts > 12, counts - 12, 0).astype(np.uint16), clock_ms)


@stream
def pad_with_a_high_rest() -> Sent:
    """A pad whose cells rest between 100 and 400 counts is rubbed."""
    counts, clock_ms = sent(hand(6, ("rub", 3.2)))
    rest = RandomState(6).uniform(100, 400, (ROWS, COLUMNS))
    return Sent(counts_of(counts + rest), clock_ms)


@stream
def pad_of_coarse_steps() -> Sent:
    """A pad that knows sixteen levels, as one of 4 bits, is patted."""
    counts, clock_ms = sent(3.0 * hand(7, ("pat", 3.2)))
    return Sent((counts // 64 * 64).astype(np.uint16), clock_ms)


@stream
def pad_of_a_third_of_the_sensitivity() -> Sent:
    """A pad that answers a third of the usual counts is stroked."""
    return sent(hand(8, ("stroke", 3.2)) / 3)


@stream
def pad_that_creeps_back() -> Sent:
    """A silicone pad keeps a fifth of a touch for seconds after the hand has gone."""
    pressed = hand(9, ("constant", 3.0), quiet_s=5.0)
    kept, creeping = np.zeros_like(pressed), np.zeros((ROWS, COLUMNS))
    for number, frame in enumerate(pressed):
        creeping += (0.2 * frame - creeping) * (0.05 if frame.max() > 5 else 0.012)
        kept[number] = creeping
    return sent(pressed + kept)


@stream
def pad_of_uneven_noise() -> Sent:
    """A quarter of the cells is five times as noisy as the others; the pad is patted."""
    counts, clock_ms = sent(hand(10, ("pat", 3.2), lead_s=4.0))
    rng = RandomState(10)
    noisy = rng.uniform(size=(ROWS, COLUMNS)) < 0.25
    return Sent(counts_of(counts + 5 * NOISE_COUNTS * noisy * rng.normal(size=counts.shape)), clock_ms)


# Touches.


@stream
def touch_brief_tap() -> Sent:
    """A fingertip taps once, for 0.15 s."""
    return sent(pressing(blob(3.5, 4.2, 0.8), 90 * down_for(0.15)))


@stream
def touch_in_passing() -> Sent:
    """A sleeve brushes over the pad in a third of a second, lightly."""
    time_s = np.arange(frames_of(6.0)) / FRAME_RATE_HZ
    place = (time_s - 2.5) / 0.33 * 9 - 1
    return sent(np.stack([14.0 * blob(4.0, at, 1.4) for at in place]))


@stream
def touch_of_a_fingertip() -> Sent:
    """A fingertip rests on one taxel with 45 counts for two seconds."""
    return sent(pressing(blob(5.0, 2.0, 0.6), 45 * down_for(2.0)))


@stream
def touch_too_light_to_recognise() -> Sent:
    """A fingertip rests on one taxel with 14 counts for two seconds; nothing is reported."""
    return sent(pressing(blob(5.0, 2.0, 0.6), 14 * down_for(2.0)))


@stream
def touch_of_a_firm_fist() -> Sent:
    """A fist presses so firmly that its middle is at the pad's limit."""
    return sent(pressing(blob(3.4, 3.8, 1.5), 1500 * down_for(2.2)))


@stream
def touch_at_the_corner() -> Sent:
    """A thumb presses the corner four times, twice a second."""
    taps = np.maximum(0.0, np.sin(4 * np.pi * np.arange(frames_of(2.0)) / FRAME_RATE_HZ))
    force = np.concatenate([np.zeros(frames_of(2.5)), taps, np.zeros(frames_of(2.0))])
    return sent(pressing(blob(0.2, 7.0, 1.0), 120 * force))


@stream
def touch_of_two_hands() -> Sent:
    """One hand rests on the left while another pats on the right."""
    still = pressing(blob(4.0, 1.5, 1.3), 40 * down_for(4.0))
    pats = pressing(blob(3.0, 6.0, 1.2), 60 * down_for(2.0, 3.5, 3.0))
    beat = 0.5 - 0.5 * np.cos(2 * np.pi * 3.5 * np.arange(len(still)) / FRAME_RATE_HZ)
    return sent(still + beat[:, None, None] * pats)


@stream
def touch_that_changes_its_gesture() -> Sent:
    """A hand that lay still for four seconds begins to scratch without leaving."""
    return sent(hand(11, ("constant", 4.0), ("scratch", 4.0)))


@stream
def touch_of_pats_and_pauses() -> Sent:
    """Three rows of pats: 0.4 s between the first two, 1.5 s before the third."""
    return sent(hand(12, ("pat", 1.2), ("notouch", 0.4), ("pat", 1.2), ("notouch", 1.5), ("pat", 1.2)))


@stream
def touch_from_before_the_start() -> Sent:
    """A hand lies on the pad when it is switched on, and leaves after three seconds; a pat follows."""
    pressed = hand(13, ("constant", 3.2), lead_s=0.0, quiet_s=2.5)
    return sent(np.concatenate([pressed[6:], hand(14, ("pat", 2.2), lead_s=0.5)]))


@stream
def touch_of_a_thing_that_stays() -> Sent:
    """A cup is put down and stays for good; a stroke beside it follows."""
    cup = pressing(blob(2.0, 2.0, 1.1), 70 * down_for(20.0, quiet_s=0.0))
    cup[-frames_of(0.1) :] = cup[-frames_of(0.2)]
    stroke = pressing(blob(6.0, 6.0, 1.0), 60 * down_for(1.0, quiet_s=1.5, lead_s=0.5))
    return sent(np.concatenate([cup, cup[-1] + stroke]))


@stream
def touch_of_slow_strokes() -> Sent:
    """A fingertip is drawn over the pad three times in six seconds, with a second off it in between."""
    time_s = np.arange(frames_of(10.0)) / FRAME_RATE_HZ
    part = (time_s - 2.5) % 2.5 / 1.5
    is_down = (time_s > 2.5) & (part < 1) & (time_s < 9.5)
    force = 45 * is_down * np.sin(np.pi * part.clip(0, 1)) ** 0.5
    return sent(np.stack([f * blob(3.5, 7 * at, 1.0) for f, at in zip(force, part, strict=True)]))


@stream
def touch_of_all_that_tickles() -> Sent:
    """A hand tickles, rests half a second on the pad, and tickles again."""
    return sent(hand(15, ("tickle", 2.0), ("constant", 0.6), ("tickle", 2.5)))


# Faults.


@stream
def fault_every_eighth_frame_lost() -> Sent:
    """Every eighth frame is lost on the way; the answers to a rub are marked degraded."""
    counts, clock_ms = sent(hand(16, ("rub", 3.2)))
    kept = np.arange(len(counts)) % 8 > 0
    return Sent(counts[kept], clock_ms[kept])


@stream
def fault_gap_in_a_touch() -> Sent:
    """Half a second of frames is lost in a stroke, which ends with the gap."""
    counts, clock_ms = sent(hand(17, ("stroke", 4.0)))
    kept = np.ones(len(counts), bool)
    kept[frames_of(4.0) : frames_of(4.5)] = False
    return Sent(counts[kept], clock_ms[kept])


@stream
def fault_silence_in_a_touch() -> Sent:
    """The pad is unplugged in a rub, and comes back after three seconds with its clock running on."""
    counts, clock_ms = sent(hand(18, ("rub", 5.5), quiet_s=2.5))
    kept = np.ones(len(counts), bool)
    kept[frames_of(4.0) : frames_of(7.2)] = False
    return Sent(counts[kept], clock_ms[kept])


@stream
def fault_few_frames() -> Sent:
    """The pad sends four frames a second, too few to recognise a touch."""
    return at_rate(hand(19, ("pat", 3.0), lead_s=8.0), 4.0)


@stream
def fault_clock_wraps_in_a_touch() -> Sent:
    """The pad's clock wraps to zero in a pat, which goes on."""
    counts, clock_ms = sent(hand(20, ("pat", 3.2)), first_ms=CLOCK_MODULUS - 4000)
    return Sent(counts, clock_ms % CLOCK_MODULUS)


@stream
def fault_board_restarts_in_a_touch() -> Sent:
    """The board restarts in a stroke, so that its clock begins again."""
    counts, clock_ms = sent(hand(21, ("stroke", 5.0), quiet_s=2.0), first_ms=60_000)
    later = clock_ms >= 64_000
    clock_ms[later] -= clock_ms[later][0]
    return Sent(counts, clock_ms)


@stream
def fault_frames_out_of_order() -> Sent:
    """Over the network, one frame in ten comes after the next one; the pad is patted."""
    counts, clock_ms = sent(hand(22, ("pat", 3.2)))
    order = np.arange(len(counts))
    order[10:-10:10], order[11:-9:10] = order[11:-9:10].copy(), order[10:-10:10].copy()
    return Sent(counts[order], clock_ms[order])


@stream
def fault_frames_twice() -> Sent:
    """Every third frame comes twice; the pad is patted."""
    counts, clock_ms = sent(hand(22, ("pat", 3.2)))
    times = np.where(np.arange(len(counts)) % 3, 1, 2)
    return Sent(np.repeat(counts, times, axis=0), np.repeat(clock_ms, times))


@stream
def fault_broken_row() -> Sent:
    """The wire of a row is broken; the log names the row, and a stroke is still recognised."""
    counts, clock_ms = sent(hand(23, ("stroke", 3.2), lead_s=14.0))
    counts[:, 5] = 0
    return Sent(counts, clock_ms)


@stream
def fault_loose_wire() -> Sent:
    """A column's wire is loose: from the fourth second on its values jump by 8 counts; a pat follows."""
    counts, clock_ms = sent(hand(24, ("pat", 3.2), lead_s=14.0))
    jumps = (clock_ms > 4000) & (clock_ms % 1300 < 500)
    counts[:, :, 2] += (8 * jumps[:, None]).astype(np.uint16)
    return Sent(counts, clock_ms)


@stream
def fault_short() -> Sent:
    """A third of the pad is at its limit for good, as with a short; at first it passes for a touch."""
    counts, clock_ms = sent(nothing(12.0))
    counts[frames_of(3.0) :, :, 5:] = MAX_COUNT
    return Sent(counts, clock_ms)


@stream
def fault_frozen() -> Sent:
    """After eight seconds the board sends the same frame again and again."""
    counts, clock_ms = sent(nothing(24.0))
    counts[frames_of(8.0) :] = counts[frames_of(8.0)]
    return Sent(counts, clock_ms)


@stream
def fault_mains_hum() -> Sent:
    """Mains hum, seen as a slow wave of 6 counts on all cells; a hand rubs through it."""
    counts, clock_ms = sent(hand(25, ("rub", 3.2), lead_s=12.0))
    wave = 6 + 6 * np.sin(2 * np.pi * 4.0 * clock_ms / 1000)
    return Sent(counts_of(counts + wave[:, None, None]), clock_ms)


@stream
def fault_motor() -> Sent:
    """A motor shakes the pad at 12 Hz from the fourth second on; a hand strokes it."""
    counts, clock_ms = sent(hand(26, ("stroke", 3.2), lead_s=8.0))
    wave = (clock_ms > 4000) * (5 + 5 * np.sin(2 * np.pi * 12.0 * clock_ms / 1000))
    gain = RandomState(26).uniform(0.7, 1.3, (ROWS, COLUMNS))
    return Sent(counts_of(counts + wave[:, None, None] * gain), clock_ms)


@stream
def fault_noise_begins() -> Sent:
    """From the fourth second on the pad is six times as noisy, too much for light touches."""
    counts, clock_ms = sent(nothing(22.0))
    noise = 6 * NOISE_COUNTS * RandomState(27).normal(size=counts.shape) * (clock_ms > 4000)[:, None, None]
    return Sent(counts_of(counts + 15 + noise), clock_ms)


@stream
def fault_rest_drifts() -> Sent:
    """The whole pad's rest rises by two counts a second; a pat after eight seconds is recognised."""
    counts, clock_ms = sent(hand(28, ("pat", 3.2), lead_s=8.0, quiet_s=2.5))
    return Sent(counts_of(counts + 2.0 * clock_ms[:, None, None] / 1000), clock_ms)


@stream
def fault_rest_steps() -> Sent:
    """The rest of all cells rises by 10 counts at once, as when the pad is clamped; a stroke follows."""
    counts, clock_ms = sent(hand(29, ("stroke", 3.2), lead_s=11.0))
    return Sent(counts_of(counts + 10.0 * (clock_ms > 4000)[:, None, None]), clock_ms)


@stream
def fault_spikes() -> Sent:
    """Single cells jump to their limit for one frame, ten times a second, while nothing touches."""
    counts, clock_ms = sent(nothing(8.0))
    rng = RandomState(30)
    hit = rng.uniform(size=counts.shape) < 10 / FRAME_RATE_HZ / counts[0].size
    return Sent(np.where(hit, MAX_COUNT, counts).astype(np.uint16), clock_ms)
