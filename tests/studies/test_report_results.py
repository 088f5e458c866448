"""The file of results: cells name their origin, and several processes may add at once."""

import subprocess
import sys
from pathlib import Path

import pytest

from touchd.model.studies.report.results import Results, ResultsError

ROOT = Path(__file__).parents[2]
PUT_MANY = """
import sys
from pathlib import Path
from touchd.model.studies.report.results import Results
results = Results(Path(sys.argv[1]))
for number in range(15):
    results.put(f"{sys.argv[2]}/{number}", {"number": number}, 0.0)
"""


def test_a_cell_keeps_its_values_and_says_what_made_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(sys, "argv", ["/somewhere/bin/touchd", "report", "--haart", "/home/anna/haart"])
    results = Results(tmp_path / "docs" / "report.json")
    assert not results.has("table/a")
    results.put("table/a", {"accuracies": [0.5, 0.75]}, 12.34567)
    again = Results(tmp_path / "docs" / "report.json")
    assert again.get("table/a") == {"accuracies": [0.5, 0.75]}
    cell = again.cell("table/a")
    assert cell.seconds == 12.346
    assert cell.command == "touchd report --haart haart"
    assert "cores" in cell.machine
    assert "onnxruntime" in cell.machine


def test_keys_are_found_by_prefix(tmp_path: Path) -> None:
    results = Results(tmp_path / "report.json")
    for key in ("b/2", "b/1", "a/1"):
        results.put(key, {}, 0.0)
    assert results.keys("b/") == ["b/1", "b/2"]
    assert results.keys() == ["a/1", "b/1", "b/2"]


def test_measuring_a_cell_again_replaces_it_and_leaves_the_others(tmp_path: Path) -> None:
    results = Results(tmp_path / "report.json")
    results.put("a", {"figure": 1}, 0.0)
    results.put("b", {"figure": 2}, 0.0)
    results.put("a", {"figure": 3}, 0.0)
    assert [results.get(key)["figure"] for key in ("a", "b")] == [3, 2]
    assert [path.name for path in tmp_path.iterdir()] == ["report.json"]


def test_processes_that_add_at_the_same_time_lose_nothing(tmp_path: Path) -> None:
    path = tmp_path / "report.json"
    adding = [
        subprocess.Popen([sys.executable, "-c", PUT_MANY, str(path), name], cwd=ROOT)
        for name in ("a", "b", "c")
    ]
    assert [process.wait(timeout=25) for process in adding] == [0, 0, 0]
    assert len(Results(path).keys()) == 45


@pytest.mark.parametrize("content", ["", "{", "[]", '{"a": 1}', '{"a": {"values": {}}}'])
def test_a_damaged_file_is_never_written_over(tmp_path: Path, content: str) -> None:
    path = tmp_path / "report.json"
    path.write_text(content)
    with pytest.raises(ResultsError, match=r"report\.json") as raised:
        Results(path).put("a", {}, 0.0)
    assert "\n" not in str(raised.value)
    assert path.read_text() == content
