"""The streams in tests/recordings, each a pad, a touch or a fault, give the expected events."""

from pathlib import Path

import pytest
from rigs import expectations
from rigs.expectations import FOLDER, STREAMS, expectation_of, expected, holds, streams, told_of

from touchd.drivers.recording import read_provenance
from touchd.model.classifier import Classifier


@pytest.mark.parametrize("path", streams(), ids=lambda path: path.name.removesuffix(".csv.gz"))
def test_a_stream_gives_its_expected_events(path: Path, classifier: Classifier) -> None:
    assert told_of(path, classifier) == expected(path), read_provenance(path).get("title")


def test_every_stream_has_a_title_and_expected_events() -> None:
    assert len(streams()) >= 30
    assert [path.name for path in streams() if not expectation_of(path).exists()] == []
    assert [path.name for path in streams() if not read_provenance(path).get("title")] == []


def test_the_made_up_streams_are_what_their_functions_make() -> None:
    assert [name for name, make in STREAMS.items() if not holds(FOLDER / f"{name}.csv.gz", make())] == []


def test_a_command_adds_a_stream_with_its_expected_events(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    tap = FOLDER / "touch-brief-tap.csv.gz"
    shipped = expected(tap)
    monkeypatch.setattr(expectations, "FOLDER", tmp_path)
    monkeypatch.setattr(expectations, "RECORDINGS", {})
    expectations.main(["--add", str(tap)])
    assert expected(tmp_path / tap.name) == shipped
