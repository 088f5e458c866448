"""The time of each stage of an answer, measured and shown as bars."""

import pytest
from rigs.robots import needs_qi

from docs.studies.stages import STAGES, Times, measure, stages_table


def test_each_stage_has_a_bar_as_long_as_its_time() -> None:
    times = Times(answers=9, stages_ms=(0.1, 0.2, 0.3, 0.0, 1.0, 0.0, 2.0), p50_ms=3.6, p99_ms=5.0)
    lines = stages_table({"before": times, "now": times}).splitlines()
    assert len(lines) == 2 + len(STAGES) + 1
    assert lines[2].count("█") == 2 * 2
    assert lines[6].count("█") == 2 * 20
    assert "3.60 / 5.00" in lines[-1]


@pytest.mark.slow
@needs_qi
def test_every_stage_takes_its_share_of_the_whole() -> None:
    times = measure(9.0)
    assert times.answers >= 2
    assert min(times.stages_ms) >= 0
    assert sum(times.stages_ms) == pytest.approx(times.p50_ms, rel=0.5)
