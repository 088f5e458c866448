"""The features of a touch, measured on made touches with known features."""

import time

import msgspec
import numpy as np
import pytest
from numpy.typing import NDArray
from rigs.made_events import PREDICTION
from rigs.scripted_model import Scripted

from touchd.daemon.path.events import Event, Prediction, TouchEnded
from touchd.daemon.path.feel import Feel, FeelMeter
from touchd.daemon.path.pipeline import Pipeline, PipelineSettings
from touchd.daemon.robot.actions import MEASURES, Action, ActionRule
from touchd.daemon.robot.reactions import Reactions
from touchd.drivers.frame import Frame

RATE_HZ = 54


def blob(row: float, column: float, counts: float) -> NDArray[np.float64]:
    """A fingertip, a taxel and a half wide."""
    rows, columns = np.mgrid[:8, :8]
    return counts * np.exp(-((rows - row) ** 2 + (columns - column) ** 2) / 1.2)


def feel_of(frames: list[NDArray[np.float64]], size_mm: tuple[float, float] | None = None) -> Feel:
    """Return the pipeline's features of these frames, with two seconds of rest on each side."""
    rest = [np.zeros((8, 8))] * (2 * RATE_HZ)
    rng = np.random.default_rng(0)
    events: list[Event] = []
    pipeline = Pipeline(PipelineSettings(size_mm=size_mm), Scripted(), events.append)
    for number, pressure in enumerate([*rest, *frames, *rest]):
        counts = np.clip(pressure + rng.integers(10, 13, (8, 8)), 0, 1023).astype(np.uint16)
        pipeline.on_frame(Frame(round(number * 1000 / RATE_HZ), time.monotonic(), counts))
    (ended,) = [event for event in events if isinstance(event, TouchEnded)]
    assert ended.feel is not None
    assert all(event.feel is not None for event in events if isinstance(event, Prediction))
    return ended.feel


def test_a_stroke_has_its_length_and_direction() -> None:
    way = np.linspace(0, 1, 2 * RATE_HZ)
    feel = feel_of([blob(5.0 - 2 * s, 1.5 + 4.5 * s, 200) for s in way], size_mm=(80, 160))
    assert feel.down == pytest.approx(-2, abs=0.4)
    assert feel.right == pytest.approx(4.5, abs=0.5)
    assert feel.path == pytest.approx(np.hypot(2, 4.5), abs=0.5)
    assert feel.direction_deg == pytest.approx(24, abs=5)
    assert feel.stroke_mm == pytest.approx(np.hypot(20, 90), rel=0.12)
    assert feel.duration_s == pytest.approx(2.0, abs=0.1)
    assert (feel.row, feel.column) == pytest.approx((4.0, 3.75), abs=0.3)


def test_pats_have_their_rhythm_and_a_still_hand_has_none() -> None:
    beats = [400 * max(0.0, np.sin(2 * np.pi * 3 * at / RATE_HZ)) for at in range(3 * RATE_HZ)]
    light = [40.0] * RATE_HZ
    assert feel_of([blob(4, 4, load) for load in light + beats]).rhythm_hz == pytest.approx(3.0, abs=0.15)
    still = feel_of([blob(4, 4, 300)] * (3 * RATE_HZ))
    assert still.rhythm_hz == 0
    assert still.path < 1
    assert still.direction_deg is None


@pytest.mark.parametrize("counts", [60, 600])
def test_pressure_and_area_are_those_of_the_hand(counts: float) -> None:
    pressed = blob(3.5, 3.5, counts)
    feel = feel_of([pressed] * RATE_HZ)
    touched = pressed[pressed > 4]
    assert feel.peak == pytest.approx(pressed.max(), abs=4)
    assert feel.area == pytest.approx(len(touched), abs=5)
    assert feel.mean == pytest.approx(touched.mean(), rel=0.3)


def test_a_touch_too_light_to_measure_has_no_load() -> None:
    meter = FeelMeter(np.zeros(64, np.float32), np.zeros(64, np.float32), None)
    meter.add(np.full((8, 8), 3.9, np.float32))
    feel = meter.feel()
    assert (feel.duration_s, feel.peak, feel.mean, feel.area, feel.rhythm_hz) == (0, 0, 0, 0, 0)


def test_a_rule_can_require_a_hard_or_short_touch() -> None:
    say = Action(say="ouch")
    hard = ActionRule(do=(say,), gestures=("pat",), above={"peak": 300}, below={"duration_s": 2})

    def says(**feel: float) -> bool:
        measured = Feel(**{**dict.fromkeys(MEASURES, 0.0), **feel}) if feel else None
        answer = msgspec.structs.replace(PREDICTION, gesture="pat", feel=measured)
        return bool(Reactions([hard]).actions(answer, 0.0))

    assert says(peak=300, duration_s=1.9)
    assert says(peak=400, duration_s=0.5)
    assert not says(peak=400, duration_s=3.0)
    assert not says(peak=299, duration_s=1.0)
    assert not says(peak=400, duration_s=2.0)
    assert not says()
    for limits in ({"above": {"peak": 0}}, {"below": {"peak": 999}}):
        assert Reactions([ActionRule(do=(say,), **limits)]).actions(PREDICTION, 0.0) == []
