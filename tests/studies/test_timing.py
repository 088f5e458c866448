"""Timing answers in turn, by wall clock and processor time."""

import time

from docs.studies.checks.timing import IN_A_ROW, time_in_turn


def test_all_are_asked_in_turn_until_each_has_answered() -> None:
    asked: list[str] = []
    timings = time_in_turn([lambda: asked.append("ours"), lambda: asked.append("theirs")], IN_A_ROW + 3)
    assert asked == ["ours"] * IN_A_ROW + ["theirs"] * IN_A_ROW + ["ours"] * 3 + ["theirs"] * 3
    assert [timing.answers for timing in timings] == [IN_A_ROW + 3] * 2


def test_waiting_takes_no_processor_time() -> None:
    (waiting,) = time_in_turn([lambda: time.sleep(0.02)], 5)
    assert waiting.p99_ms >= waiting.p50_ms >= 19.0
    assert waiting.processor_ms < 10.0
