"""The time of each stage of an answer, measured and shown as bars."""

import math

import numpy as np
import pytest
from rigs.robots import needs_qi

from touchd.model.studies.stages import STAGES, NotTimedError, Times, measure, stages_table, times_of


def test_each_stage_has_a_bar_as_long_as_its_time() -> None:
    times = Times(answers=9, stages_ms=(0.1, 0.2, 0.3, 0.0, 1.0, 0.0, 2.0), p50_ms=3.6, p99_ms=5.0)
    lines = stages_table({"before": times, "now": times}).splitlines()
    assert len(lines) == 2 + len(STAGES) + 1
    assert lines[2].count("█") == 2 * 2
    assert lines[6].count("█") == 2 * 20
    assert "3.60 / 5.00" in lines[-1]


SENT_S = np.arange(10) / 10
PASSED_S = (0.501, 0.502, 0.503, 0.504, 0.506, 0.507)


def test_an_answer_is_timed_from_its_frame_to_the_robot() -> None:
    times = times_of(SENT_S, [PASSED_S], [0.51])
    assert times == Times(answers=1, stages_ms=(1.0, 1.0, 1.0, 1.0, 2.0, 1.0, 3.0), p50_ms=10.0, p99_ms=10.0)


@pytest.mark.parametrize(
    ("rows", "raised_s"),
    [([], []), ([PASSED_S], []), ([PASSED_S], [0.4]), ([(math.nan,) * 6], [0.51])],
    ids=["none told", "none raised", "raised before", "not at a mark"],
)
def test_where_no_answer_can_be_timed_it_says_so(
    rows: list[tuple[float, ...]], raised_s: list[float]
) -> None:
    with pytest.raises(NotTimedError, match="on a machine at rest"):
        times_of(SENT_S, rows, raised_s)


@pytest.mark.slow
@needs_qi
def test_every_stage_takes_its_share_of_the_whole() -> None:
    times = measure(9.0)
    assert times.answers >= 2
    assert min(times.stages_ms) >= 0
    assert sum(times.stages_ms) == pytest.approx(times.p50_ms, rel=0.5)
