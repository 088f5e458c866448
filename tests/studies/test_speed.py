"""The time of one answer, in turn with others', and relative to the paper's network."""

from pathlib import Path

import pytest

pytest.importorskip("torch", reason="needs the extra `train`")
pytest.importorskip("onnx", reason="needs the extra `train`")

from touchd.model.classifier import SHIPPED_MODEL, Classifier
from touchd.model.settings import LENGTHS
from touchd.model.studies import speed
from touchd.model.studies.checks.timing import IN_A_ROW, time_interleaved
from touchd.model.studies.paper_network import PaperSettings
from touchd.model.studies.speed import NEXT_FRAME, WINDOW, Asked, Measured, Speed


def timed(network: str, frames: int, processor_ms: float) -> Speed:
    return Speed(
        network=network,
        asked=WINDOW,
        frames=frames,
        file_bytes=1_720_000,
        processor_ms=processor_ms,
        error=0.1,
    )


def test_times_are_compared_with_the_shipped_window() -> None:
    speeds = (timed("ours", 144, 2.0), timed("ours", 54, 1.0), timed("a", 144, 20.0), timed("a", 54, 9.0))
    rows = speed.rows(Measured("a machine", speeds))
    assert [(row[0], row[3]) for row in rows] == [("ours", "1.00"), ("a", "10.00")]


@pytest.mark.slow
@pytest.mark.timeout(300)
def test_ours_and_a_small_network_of_the_papers_are_timed(tmp_path: Path) -> None:
    small = PaperSettings("public", frames=144, blocks=1, width=8, heads=2)
    asked = speed.ours(SHIPPED_MODEL, lambda frames: frames / 1000)
    asked.append(speed.paper("the paper's", small, tmp_path, None))
    speeds = speed.run(asked, answers=2).speeds
    longest, *shorter = sorted(LENGTHS, reverse=True)
    assert [each.frames for each in speeds] == [longest, longest, *shorter, 144]
    assert [each.asked for each in speeds] == [WINDOW, NEXT_FRAME, WINDOW, WINDOW, WINDOW]
    assert speeds[0].network == Classifier.load().name
    assert speeds[0].file_bytes == SHIPPED_MODEL.stat().st_size
    assert speeds[0].error == 0.144
    assert all(each.processor_ms > 0 for each in speeds)


@pytest.mark.slow
@pytest.mark.timeout(300)
def test_every_network_of_the_table_is_asked(tmp_path: Path) -> None:
    asked = speed.answers_of(SHIPPED_MODEL, tmp_path)
    assert len({each.network for each in asked}) == 7
    assert all(isinstance(each, Asked) and each.answer() is not None for each in asked)


def test_all_are_called_in_rotation_until_each_has_answered() -> None:
    asked: list[str] = []
    times = time_interleaved([lambda: asked.append("ours"), lambda: asked.append("theirs")], IN_A_ROW + 3)
    assert asked == ["ours"] * IN_A_ROW + ["theirs"] * IN_A_ROW + ["ours"] * 3 + ["theirs"] * 3
    assert len(times) == 2
