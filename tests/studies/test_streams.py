"""The streams of another kind of pad: how they are scored, and that the page states their scores."""

import csv
from pathlib import Path

import numpy as np
import pytest
from rigs.haart_folder import THIRD_STUDY, needs_third_study

from touchd.model.classifier import Classifier
from touchd.model.studies.sessions.streams import StreamScore, held_out, measure

HZ = 45


def stream(number: int, gesture: str, levels: list[tuple[float, float]]) -> list[list[object]]:
    """Return a stream's rows; levels: seconds, and the counts on the pad's middle, 0 where nobody touches."""
    rng = np.random.default_rng(number)
    rows: list[list[object]] = []
    for seconds, level in levels:
        for _ in range(round(seconds * HZ)):
            cells = np.rint(rng.normal(3, 1, (6, 6)))
            cells[1:5, 1:5] += level
            label = gesture if level else ""
            rows.append(
                [number, "S01", "flat", gesture, len(rows) * 1000 // HZ, label, *cells.ravel().astype(int)]
            )
    return rows


def test_streams_are_scored_by_what_the_daemon_says(tmp_path: Path, classifier: Classifier) -> None:
    names = ["stream", "participant", "substrate", "gesture", "ms", "label", *(f"c{i}" for i in range(1, 37))]
    held, twice = [(2.0, 0.0), (5.0, 60.0), (3.0, 0.0)], [(2.0, 0.0), (4.0, 60.0), (3.0, 0.0), (4.0, 60.0)]
    made = [
        ("constant", held),
        ("constant", twice),
        ("notouch", [(6.0, 0.0)]),
        ("notouch", held),
        ("poke", held),
    ]
    rows = [row for number, (gesture, levels) in enumerate(made) for row in stream(number, gesture, levels)]
    with (tmp_path / "streams.csv").open("w", newline="") as file:
        csv.writer(file).writerows([names, *rows])
    assert measure(tmp_path, {"S01": classifier}) == StreamScore(
        touched=2, missed=0, several=1, named=2, right=2, rest=2, false=1
    )


@pytest.mark.slow
@needs_third_study
def test_the_page_says_what_the_streams_give() -> None:
    models = held_out()
    result = measure(Path(str(THIRD_STUDY)), models)
    page = " ".join((Path(__file__).parents[2] / "docs" / "sessions.md").read_text("utf-8").split())
    share, right = 100 * result.several / result.touched, 100 * result.right / result.named
    detected = f"of {result.touched} touches is missed and {result.several} ({share:.1f} %) are split"
    assert f"none {detected}" in page
    assert f"touches begin in {result.false} of {result.rest} recordings without any" in page
    assert result.missed == 0
    assert share <= 10
    assert right >= 75
