"""What the live page is told besides the events: what the model makes of a touch, and what was before."""

from __future__ import annotations

from collections.abc import Iterator

import msgspec
import pytest
from rigs.expectations import RECORDINGS, answers, stream_of

from daemon.config import Settings
from daemon.events import Event, Prediction, TouchBegan
from daemon.live.leaning import Leanings
from daemon.live.memory import PREDICTIONS, TOUCHES, Memory, Scene
from daemon.live.messages import Leaning
from daemon.pipeline import Pipeline
from daemon.service import load_model
from drivers.frame import Frame

STREAM = stream_of(next(path for path in RECORDINGS if path.name == "lengths.csv.gz"))
NOW = "2026-11-20T10:00:00.000Z"


@pytest.fixture(scope="module")
def scene() -> Scene:
    return Scene(Settings().pipeline, load_model(Settings()), robot_configured=False)


def frames(start: int = 0) -> Iterator[Frame]:
    for number, counts in enumerate(STREAM.counts[start:], start):
        yield Frame(number, int(STREAM.sensor_ms[number]), 0.0, counts)


def test_between_answers_the_page_is_told_what_the_model_makes_of_the_same_frames(scene: Scene) -> None:
    leanings = Leanings(scene)
    begins: dict[int, int] = {}
    said: list[Leaning] = []

    def note(event: Event) -> None:
        if isinstance(event, TouchBegan):
            begins[event.touch] = STREAM.sensor_ms.tolist().index(event.sensor_ms)
        leanings.put(event)

    pipeline = Pipeline(scene.settings, scene.model, note)
    for frame in frames():
        pipeline.on_frame(frame)
        if leaning := leanings.push(frame):
            said.append(leaning)
    assert len(said) > 50
    assert {leaning.touch for leaning in said} == set(begins)
    # Never when an answer falls due, which it could delay.
    assert not {leaning.frames for leaning in said} & {54, 81, 144, 171, 198}
    for leaning in said[::5]:
        first = begins[leaning.touch]
        window = STREAM.counts[first : first + leaning.frames][-144:]
        made_of_it = dict(zip(scene.model.labels, scene.model.probabilities(window), strict=True))
        assert leaning.probabilities == pytest.approx(made_of_it, abs=1e-3)


def test_a_touch_whose_beginning_was_not_seen_is_not_guessed_about(scene: Scene) -> None:
    leanings = Leanings(scene)
    leanings.put(TouchBegan(touch=1, time=NOW, sensor_ms=0))
    assert [leaning for frame in frames(300) if (leaning := leanings.push(frame))] == []


def test_a_page_that_is_behind_asks_the_model_nothing(scene: Scene) -> None:
    leanings = Leanings(scene)
    said: list[Leaning | None] = []
    pipeline = Pipeline(scene.settings, scene.model, leanings.put)
    for frame in frames():
        pipeline.on_frame(frame)
        said.append(leanings.push(frame, may_ask=False))
    assert set(said) == {None}


def test_what_is_remembered_for_who_comes_late_is_bounded(scene: Scene) -> None:
    memory = Memory(scene)
    prediction = next(event for event in answers(STREAM, scene.model) if isinstance(event, Prediction))
    for touch in range(1, 3 * TOUCHES):
        memory.put(TouchBegan(touch=touch, time=NOW, sensor_ms=0))
        for _ in range(2 * PREDICTIONS):
            memory.put(msgspec.structs.replace(prediction, touch=touch))
    touches = memory.state("", "pad", ("pad",)).touches
    assert [felt.began.touch for felt in touches] == list(range(2 * TOUCHES, 3 * TOUCHES))
    assert {len(felt.predictions) for felt in touches} == {PREDICTIONS}
