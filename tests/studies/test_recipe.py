"""The shipped recipe: who is left out of what, and what each network begins from."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("torch", reason="needs the extra `train`")

from docs.studies.training.recipe import SHIPPED_RECIPE, WIDE_RECIPE, final_jobs, fold_jobs, plan, read_recipe
from drivers.recording import Recording, ideal_clock_ms
from model.training import second_study

HAART_PEOPLE = ("P3", "P4", "P5", "P6", "P7", "P8", "P10")
SECOND_PEOPLE = ("R02", "R04", "R06", "R08", "R10", "R12", "R14", "R16")


def test_every_network_is_trained_after_the_one_it_begins_from() -> None:
    for path in (SHIPPED_RECIPE, WIDE_RECIPE):
        recipe = read_recipe(path)
        done: set[str] = set()
        for job in plan(recipe, Path("runs")):
            begins_from = job.settings.begins_from
            assert not begins_from or Path(begins_from).parent.name in done
            done.add(job.name)
        assert {job.name for job in (*fold_jobs(recipe, Path()), *final_jobs(recipe, Path()))} <= done


def test_every_person_is_left_out_once() -> None:
    left_out = [person for job in fold_jobs(read_recipe(), Path()) for person in job.settings.left_out]
    assert sorted(left_out) == sorted({*HAART_PEOPLE, *SECOND_PEOPLE})


def made(takes: int) -> Recording:
    counts = np.arange(540 * takes, dtype=np.uint16)[:, None, None] % 1000 + np.zeros((8, 8), np.uint16)
    return Recording("R02", "static", "none", "rub", counts, ideal_clock_ms(len(counts)), "live")


def test_each_take_is_learnt_from_without_its_edges() -> None:
    takes = second_study.takes([made(1), made(2)])
    assert [len(take.counts) for take in takes] == [486] * 3
    assert [int(take.counts[0, 0, 0]) for take in takes] == [27, 27, 567]


def test_eight_seconds_of_the_first_take_are_scored() -> None:
    (scored,) = second_study.scored([made(2)])
    assert [int(scored.counts[i, 0, 0]) for i in (0, -1)] == [54, 485]
    assert len(scored.sensor_ms) == 432
