"""The detector: a network that returns, frame by frame, the probability that a hand is on the pad."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeAlias

import msgspec
import numpy as np
import onnxruntime
from numpy.typing import NDArray

from touchd.model.classifier import ModelError, open_session

SHIPPED_DETECTOR = Path(__file__).parent / "weights" / "detector.onnx"
# Rest is measured for half a second on the untouched pad.
REST_FRAMES = 27
# A touch begins after BEGIN_FRAMES frames above BEGINS, or with one above SURE.
BEGINS, BEGIN_FRAMES, SURE = 0.95, 4, 0.985
# Above this, a hand is likely; the classifier has to confirm it.
LIKELY = 0.7
# A touch ends once the probability has been at most this for `quiet_s`.
GOES_ON = 0.2
METADATA_KEY = "touchd-detector"
STATES = ("levels", "noise", "peak", "hidden")
# Mean of |a - b| for two normal values, in standard deviations.
STEP_DEVIATIONS = 1.128
# Where rounding removes a pad's noise, one count must not look like a hand.
LEAST_NOISE_COUNTS = 0.5
NOW_TOUCHED, NOW_UNTOUCHED = np.ones((1, 1), np.float32), np.zeros((1, 1), np.float32)

DetectorState: TypeAlias = Mapping[str, NDArray[np.float32]]
"""What is known of the pad before a frame, by the names in STATES: see `signals.Pad`. The caller keeps it."""


@dataclass(frozen=True)
class Detector:
    """The network. width: of its memory. training: the settings of its training."""

    session: onnxruntime.InferenceSession
    width: int
    training: dict[str, Any]

    @classmethod
    def load(cls, path: Path = SHIPPED_DETECTOR) -> "Detector":
        """Load an exported detector; raises ModelError if it is missing, damaged or not a detector."""
        session = open_session(path, 1)
        stored = session.get_modelmeta().custom_metadata_map.get(METADATA_KEY)
        if stored is None:
            raise ModelError(f"{path}: not a detector of touchd; install touchd again")
        widths = {entry.name: entry.shape[1] for entry in session.get_inputs()}
        return cls(session, widths["hidden"], msgspec.json.decode(stored, type=dict[str, Any]))

    def begin(self, frames: NDArray[np.float32]) -> DetectorState:
        """Return the state after (T, 64) counts of a pad that nobody touches."""
        rest = median(frames)
        noise = np.abs(frames[1:] - frames[:-1]).mean(axis=0) / np.float32(STEP_DEVIATIONS)
        return {
            "levels": np.stack([rest, frames[-1], rest])[np.newaxis],
            "noise": np.maximum(noise, np.float32(LEAST_NOISE_COUNTS))[np.newaxis, np.newaxis],
            "peak": np.zeros((1, 1), np.float32),
            "hidden": np.zeros((1, self.width), np.float32),
        }

    def step(
        self, counts: NDArray[np.float32], state: DetectorState, *, is_touch: bool
    ) -> tuple[float, DetectorState]:
        """Return the probability that a hand is on the pad in a frame, (64,) counts, and the next state.

        is_touch: whether a touch is in progress; rest and noise then stay unchanged.
        """
        now = {
            "counts": counts[np.newaxis, np.newaxis],
            "is_touch": NOW_TOUCHED if is_touch else NOW_UNTOUCHED,
        }
        probability, *after = self.session.run(None, {**now, **state})
        return probability.item(), dict(zip(STATES, after, strict=True))


def at_rest(state: DetectorState, frames: NDArray[np.float32], *, forgets_hand: bool) -> DetectorState:
    """Return the state with (T, 64) counts of an untouched pad as its rest.

    forgets_hand: whether to clear the network's memory too, which still holds a hand.
    """
    levels = state["levels"].copy()
    levels[0, 0] = median(frames)
    hidden = np.zeros_like(state["hidden"]) if forgets_hand else state["hidden"]
    return {**state, "levels": levels, "hidden": hidden}


def after_gap(state: DetectorState, counts: NDArray[np.float32]) -> DetectorState:
    """Return the state for (64,) counts after a gap, so that the change across it is not movement."""
    levels = state["levels"].copy()
    levels[0, 1:] = counts
    return {**state, "levels": levels}


def median(frames: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return the lower median (64,) of (T, 64) counts."""
    # np.median would import numpy.ma, which stalls the loop for 20 ms.
    ordered: NDArray[np.float32] = np.sort(frames, axis=0)
    return np.asarray(ordered[(len(frames) - 1) // 2])
