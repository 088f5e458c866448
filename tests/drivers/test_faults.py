"""Retries back off while a peer is missing; a fault that flaps is logged ever less often."""

import logging

import numpy as np
import pytest

from touchd.drivers.faults import AGAIN_S, MOST_CAUSES, Backoff, FaultLog


def test_attempts_back_off_and_recover() -> None:
    backoff = Backoff(0.1, 1.0)
    for longest in (0.1, 0.2, 0.4, 0.8, 1.0, 1.0, 1.0, 1.0):
        assert longest / 2 <= backoff.pause_s() <= longest
    backoff.reset()
    assert backoff.pause_s() <= 0.1


def lines(caplog: pytest.LogCaptureFixture, *lasting_s: tuple[float, float]) -> list[str]:
    """Return what is logged of a fault that lasts in these spans of seconds, noted four times a second."""
    caplog.set_level(logging.INFO)
    faults, now_s = FaultLog(logging.getLogger("test"), "pad: "), 0.0
    for begin_s, end_s in lasting_s:
        now_s = begin_s
        while now_s < end_s:
            faults.begin("down", "gone", now_s)
            now_s += 0.25
        faults.end("down", "back", end_s)
    return [f"{record.levelname} {record.message}" for record in caplog.records]


GONE, BACK = "WARNING pad: gone", "INFO pad: back (after {} s)"


@pytest.mark.parametrize(
    ("lasting_s", "logged"),
    [
        pytest.param([(5.0, 9.0)], [GONE, BACK.format("4.0")], id="once"),
        pytest.param([(0, 86_400)], [GONE, BACK.format("86400.0")], id="all day"),
        pytest.param([(0, 1), (20, AGAIN_S - 1)], [GONE, BACK.format("1.0")], id="again soon"),
        pytest.param(
            [(0, 1), (20, AGAIN_S + 1)],
            [GONE, BACK.format("1.0"), GONE, BACK.format("281.0")],
            id="again soon, and it lasts",
        ),
    ],
)
def test_a_fault_is_logged_when_it_begins_and_ends(
    caplog: pytest.LogCaptureFixture, lasting_s: list[tuple[float, float]], logged: list[str]
) -> None:
    assert lines(caplog, *lasting_s) == logged


def test_another_cause_is_a_warning_once(caplog: pytest.LogCaptureFixture) -> None:
    faults = FaultLog(logging.getLogger("test"))
    causes = ["unplugged", "passing", "busy", "busy", "busy", "unplugged", "unplugged"]
    news = [faults.begin("down", cause, 0.0, cause) for cause in causes]
    assert news == [True, False, False, True, False, False, False]
    assert [record.message for record in caplog.records] == ["unplugged", "busy"]
    # A peer may send any number of texts.
    more = [faults.begin("down", "text", 0.0, str(number // 2)) for number in range(100)]
    assert sum(more) == MOST_CAUSES - 2


@pytest.mark.parametrize("lasts_s", [0.5, 4.0, 30.0, 300.0])
def test_an_hour_of_flapping_is_a_few_lines(caplog: pytest.LogCaptureFixture, lasts_s: float) -> None:
    spans = [(float(at), at + lasts_s) for at in np.arange(0.0, 3600.0, 2 * lasts_s)]
    assert len(lines(caplog, *spans)) <= 24
