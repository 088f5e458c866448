"""Another pad: adapted to on some people, and asked about by another whom nobody has seen on it.

The other pad is HAART's with a row of taxels dead, the disturbance that costs the shipped network most.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from docs.studies.adapting.cells import OtherPad
from docs.studies.adapting.score import draw, score
from drivers.recording import Recording
from model.adapt.adapt import Start, learnable
from model.adapt.backbone import windows
from model.adapt.head import AdaptSettings, fit
from model.checks.disturb import DISTURBANCES, Disturb
from model.training import haart

PADS = ("none", "one dead row")


def other_pads(
    start: Start, name: str, unseen: Sequence[Recording], settings: AdaptSettings
) -> Iterator[OtherPad]:
    """Yield how a participant is answered on each pad before and after adapting to the others of the fold.

    unseen: the recordings of everybody whom the start never saw. Of each of the others, four recordings a
    gesture are learnt from; the participant is asked about with all there are.
    """
    chosen = [
        unseen[i]
        for other in sorted({recording.participant for recording in unseen} - {name})
        for own in draw(unseen, other, 0)[0]
        for i in own
    ]
    asked = haart.only(unseen, (name,))
    everything = np.arange(len(asked))
    for pad in PADS:
        there = [_on_pad(recording, DISTURBANCES[pad]) for recording in asked]
        cut = windows(start.front, there)
        shown = learnable(start, [_on_pad(recording, DISTURBANCES[pad]) for recording in chosen], settings)
        head = fit(start.head, haart.GESTURES, [], shown, None, settings)
        yield OtherPad(
            participant=name,
            pad=pad,
            before=score(start.head, start.temperatures, there, cut, everything).accuracy,
            after=score(head, start.temperatures, there, cut, everything).accuracy,
        )


def _on_pad(recording: Recording, disturb: Disturb) -> Recording:
    """Return the recording as another pad would have made it."""
    counts = disturb(recording.counts[np.newaxis].astype(np.float32))[0]
    return replace(recording, counts=np.rint(counts).astype(np.uint16))
