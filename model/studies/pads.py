"""Accuracy on pads other than the lab's: `python -m touchd.model.studies pads` fills docs/pads.md's table.

The simulated hand makes the same touches on every pad, rendered on the pad's cells and sent as its bytes.
"""

import sys
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import msgspec
import numpy as np
from numpy.random import RandomState

from touchd.daemon.config import Settings
from touchd.daemon.events import TouchBegan, TouchEnded
from touchd.daemon.setup.parts import load_model
from touchd.drivers.frame import FRAME_RATE_HZ, Frame
from touchd.drivers.pad.format import PRESETS, PadFormat, encode_values
from touchd.drivers.pad.protocol import parser_of
from touchd.drivers.recording import NO_TOUCH
from touchd.model.studies.folders import study_parser
from touchd.model.studies.hand import GESTURES, pressure, read_pad
from touchd.model.studies.marked import fill, table
from touchd.model.studies.play import play

PAGE = Path(__file__).parents[2] / "docs" / "pads.md"
QUIET_S, TOUCH_S = 2.0, 3.8
HANDS = 5
SEED = 7
# How much later than its predecessor a frame of a pad without a clock may arrive, in seconds.
JITTER_S = 0.004
# A pad counts as ruined when touches are missed, or right answers are fewer by this share, than on the lab's.
FELT_SHARE, RIGHT_SHARE = 0.9, 0.2


@dataclass(frozen=True)
class Rung:
    """A pad. gain: its counts for the same hand, relative to the lab's pad."""

    name: str
    described: PadFormat
    gain: float = 1.0


LAB = Rung("the lab's, `fabric-grid`", PRESETS["fabric-grid"])
FINE = PadFormat(header="aaabac", cell="u12", clock=True, rows=32, columns=32, full_scale=4095, rate_hz=100)
LADDER = (
    LAB,
    *(Rung(f"`{name}`", preset) for name, preset in PRESETS.items() if name != "fabric-grid"),
    Rung("32x32, 12 bit, 100 Hz", FINE),
    Rung("the lab's, 20 Hz", msgspec.structs.replace(LAB.described, rate_hz=20)),
    Rung("the lab's, 500 Hz", msgspec.structs.replace(LAB.described, rate_hz=500)),
    Rung("the lab's, half as sensitive", PRESETS["fabric-grid"], 0.5),
    Rung("the lab's, twice as sensitive", PRESETS["fabric-grid"], 2.0),
)


@dataclass(frozen=True)
class PadScore:
    """Of so many touches, how many were felt as one and how many were answered right in the end."""

    touches: int
    felt: int
    right: int

    def is_ruined(self, lab: "PadScore") -> bool:
        """Whether touches are missed, or answered worse, than on the lab's pad."""
        return self.felt < FELT_SHARE * lab.felt or lab.right - self.right > RIGHT_SHARE * self.touches


def main(arguments: Sequence[str]) -> int:
    """Play every pad and fill the table in; returns 0."""
    study_parser("pads", __doc__).parse_args(arguments)
    fill(PAGE, {"ladder": table_of([(rung, score(rung, HANDS)) for rung in LADDER])})
    return 0


def table_of(scores: Sequence[tuple[Rung, PadScore]]) -> str:
    """Return the table of all pads, the lab's first."""
    lab = scores[0][1]
    rows = [
        (
            rung.name,
            f"{rung.described.rows}x{rung.described.columns}",
            f"{each.felt} of {each.touches}",
            f"{each.right} of {each.touches}",
            "**ruined**" if each.is_ruined(lab) else "",
        )
        for rung, each in scores
    ]
    return table(("pad", "cells", "touches felt", "right in the end", ""), rows)


def score(rung: Rung, hands: int) -> PadScore:
    """Play so many hands on a pad, each with every gesture; return how many were felt and right."""
    gestures = [gesture for gesture in GESTURES if gesture != NO_TOUCH] * hands
    events = play(frames_of(rung, gestures), load_model(Settings()), flush=True)
    sys.stderr.write(f"{rung.name}: {len(gestures)} touches\n")
    began = {event.touch: event.sensor_ms / 1000 for event in events if isinstance(event, TouchBegan)}
    ended = {event.touch: event.gesture for event in events if isinstance(event, TouchEnded)}
    answers = []
    for number in range(len(gestures)):
        start_s = QUIET_S + number * (TOUCH_S + QUIET_S)
        inside = [touch for touch, at_s in began.items() if start_s - 0.3 < at_s < start_s + TOUCH_S + 0.3]
        answers.append(ended[inside[0]] if len(inside) == 1 else None)
    felt = sum(answer is not None for answer in answers)
    right = sum(answer == gesture for answer, gesture in zip(answers, gestures, strict=True))
    return PadScore(len(gestures), felt, right)


def frames_of(rung: Rung, gestures: Sequence[str]) -> Iterator[Frame]:
    """Yield the frames that the pad's parser reads from the gestures' bytes, each between quiet times."""
    described = rung.described
    cells = (described.rows - 2 * described.crop, described.columns - 2 * described.crop)
    rng = RandomState(SEED)
    quiet = np.zeros((round(QUIET_S * FRAME_RATE_HZ), *cells))
    touches = [pressure(gesture, round(TOUCH_S * FRAME_RATE_HZ), rng, cells) for gesture in gestures]
    pressed = np.concatenate([part for touch in touches for part in (quiet, touch)] + [quiet])
    time_s = np.arange(0.0, (len(pressed) - 2) / FRAME_RATE_HZ, 1.0 / described.rate_hz)
    below = (time_s * FRAME_RATE_HZ).astype(int)
    share = (time_s * FRAME_RATE_HZ - below)[:, None, None]
    pressed = rung.gain * (pressed[below] * (1.0 - share) + pressed[below + 1] * share)
    values = np.pad(read_pad(pressed, rng, described.full_scale), ((0, 0), *[(described.crop,) * 2] * 2))
    if described.invert:
        values = (described.full_scale - values).astype(np.uint16)
    parser = parser_of(described)
    for at_s, grid in zip(time_s.tolist(), values, strict=True):
        if parser.poll:
            parser.ask(at_s)
        sensor_ms = round(1000 * at_s) if described.clock else None
        yield from parser.feed(encode_values(described, grid, sensor_ms), at_s + rng.uniform(0.0, JITTER_S))
