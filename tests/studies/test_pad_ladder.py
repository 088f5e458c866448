"""The ladder of simulated pads: its table marks a pad that ruins the answers."""

import numpy as np

from touchd.model.studies.pads import LAB, LADDER, PadScore, Rung, frames_of, score, table_of


def test_a_pad_that_feels_nothing_is_marked_ruined() -> None:
    deaf = Rung("deaf", LAB.described, gain=1 / 64)
    scores = [(rung, score(rung, 1)) for rung in (LAB, deaf)]
    lab, ruined = table_of(scores).splitlines()[2:]
    assert scores[0][1].felt >= 5
    assert "**ruined**" not in lab
    assert "**ruined**" in ruined


def test_a_pad_on_which_answers_go_wrong_is_marked_ruined() -> None:
    lab = PadScore(30, 30, 20)
    assert not PadScore(30, 30, 14).is_ruined(lab)
    assert PadScore(30, 30, 13).is_ruined(lab)
    assert PadScore(30, 26, 20).is_ruined(lab)


def test_every_pad_is_given_the_same_hand() -> None:
    loads = []
    for rung in LADDER:
        felt = np.stack([frame.pressure for frame in frames_of(rung, ["constant"])]).astype(float)
        at = round(3.0 * rung.described.rate_hz)
        loads.append((felt[at : at + 40].mean() - felt[:40].mean()) / rung.gain)
    # All read the same load, within the differences of their taxels' sensitivity.
    assert max(loads) < 1.35 * min(loads)
