"""The streams and lines in tests/recordings, each a pad, a touch or a fault, give the expected events."""

from pathlib import Path

import pytest
from rigs import pairs, rebuild
from rigs.expectations import FOLDER, expectation_of, expected

from touchd.model.classifier import Classifier


@pytest.mark.parametrize("path", pairs.paths(), ids=lambda path: path.name.partition(".")[0])
def test_a_stream_gives_its_expected_events(path: Path, classifier: Classifier) -> None:
    assert pairs.told_of(path, classifier) == expected(path)


def test_every_stream_has_its_expected_events() -> None:
    assert len(pairs.paths()) >= 30
    assert [path.name for path in pairs.paths() if not expectation_of(path).exists()] == []


def test_a_command_adds_a_stream_with_its_expected_events(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    tap = FOLDER / "touch-brief-tap.csv.gz"
    shipped = expected(tap)
    for module in ("expectations", "pairs"):
        monkeypatch.setattr(f"rigs.{module}.FOLDER", tmp_path)
    monkeypatch.setattr(rebuild, "RECORDINGS", ())
    rebuild.main(["--add", str(tap)])
    assert expected(tmp_path / tap.name) == shipped
