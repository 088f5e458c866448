"""What is learnt from in the study of teaching: whole touches, single ones, labels."""

import random
from dataclasses import replace

import pytest

pytest.importorskip("torch", reason="needs the extra `train`")

from touchd.drivers.recording import Recording
from touchd.model.studies.sessions.passing import sessions
from touchd.model.studies.simulated import simulate
from touchd.model.studies.teaching import LABELLED, LABELS, LONG, LONG_FRAMES, SINGLE, lessons, touches_of
from touchd.model.training import haart


def two_set_ups() -> list[Recording]:
    return [
        replace(each, participant="R01", cover=cover, gesture=gesture)
        for seed, cover in enumerate(("none", "fur"))
        for each, gesture in zip(
            simulate([(gesture, 8.0) for gesture in haart.GESTURES], seed=seed), haart.GESTURES, strict=True
        )
    ]


def test_a_person_teaches_six_seconds_and_single_touches() -> None:
    found = lessons(two_set_ups(), random.Random(0))
    assert len(found[LONG]) == 2 * len(haart.GESTURES)
    assert {len(each.counts) for each in found[LONG]} == {LONG_FRAMES}
    single = found[SINGLE][len(found[LONG]) :]
    assert sorted(each.gesture for each in single) == ["pat", "pat", "stroke", "stroke"]
    assert len(found[LABELLED]) == LABELS


def test_a_touch_in_passing_is_cut_with_the_rest_around_it() -> None:
    session = next(sessions(two_set_ups()))
    made = [touch for touch in session.touches if touch.is_in_mix]
    saved = touches_of(session)
    assert [each.gesture for each in saved] == [touch.gesture for touch in made]
    for each, touch in zip(saved, made, strict=True):
        assert each.over - each.first == touch.stop - touch.start
        assert (each.counts[each.first : each.over] == session.counts[touch.start : touch.stop]).all()
