"""The time of one answer, in turn with others', and compared with the paper's network."""

import time

import pytest

pytest.importorskip("torch", reason="needs the extra `train`")
pytest.importorskip("onnx", reason="needs the extra `train`")

from rich.console import Console

from touchd.model.classifier import SHIPPED_MODEL
from touchd.model.settings import LENGTHS
from touchd.model.studies import speed
from touchd.model.studies.checks.timing import IN_A_ROW, Timing, time_in_turn
from touchd.model.studies.report.paper_tgc import PaperSettings
from touchd.model.studies.speed import ONNX_RUNTIME, PYTORCH, Speed


def timed(network: str, runtime: str, processor_ms: float) -> Speed:
    return Speed(network, runtime, 144, 1_720_000, Timing(200, 99.0, 99.0, processor_ms))


def test_our_share_is_of_processor_time_in_each_runtime() -> None:
    speeds = [timed("ours", ONNX_RUNTIME, 2.0), timed("a", ONNX_RUNTIME, 20.0), timed("a", PYTORCH, 40.0)]
    assert [each.share for each in speed.with_shares(speeds)] == [None, 0.1, 0.05]


def test_ours_and_a_small_network_of_the_papers_are_timed() -> None:
    small = PaperSettings("public", frames=144, blocks=1, width=8, heads=2)
    speeds = speed.run(SHIPPED_MODEL, answers=2, paper=[small])
    longest, *shorter = sorted(LENGTHS, reverse=True)
    assert [each.frames for each in speeds] == [longest, longest, *shorter, 144, 144]
    assert speeds[1].runtime == speed.BY_STATE
    assert speeds[1].share == speeds[1].timing.processor_ms / speeds[0].timing.processor_ms
    assert [each.runtime for each in speeds[-2:]] == [ONNX_RUNTIME, PYTORCH]
    assert speeds[0].file_bytes == SHIPPED_MODEL.stat().st_size
    console = Console(width=200)
    with console.capture() as shown:
        console.print(speed.table(speeds))
    assert "tgc-public" in shown.get()
    assert "1/25" in shown.get()


def test_all_are_asked_in_turn_until_each_has_answered() -> None:
    asked: list[str] = []
    timings = time_in_turn([lambda: asked.append("ours"), lambda: asked.append("theirs")], IN_A_ROW + 3)
    assert asked == ["ours"] * IN_A_ROW + ["theirs"] * IN_A_ROW + ["ours"] * 3 + ["theirs"] * 3
    assert [timing.answers for timing in timings] == [IN_A_ROW + 3] * 2


def test_waiting_takes_no_processor_time() -> None:
    (waiting,) = time_in_turn([lambda: time.sleep(0.02)], 5)
    assert waiting.p99_ms >= waiting.p50_ms >= 19.0
    assert waiting.processor_ms < 10.0
