"""Pages show the stored figures, and stored results name their origin."""

import shutil
import sys
from collections.abc import Callable
from itertools import product
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("torch", reason="needs the extra `train`")

from touchd.model.adapt.head import AdaptSettings
from touchd.model.classifier import SHIPPED_MODEL
from touchd.model.studies import accuracy, adapting, decision, new_pad, others, paper, speed, tables
from touchd.model.studies.challenge import table as challenge
from touchd.model.studies.checks.scores import read_scores
from touchd.model.studies.marked import PLACE, PageError, fill, percent, table
from touchd.model.studies.results import Results, ResultsError, stored
from touchd.model.studies.sessions import passing
from touchd.model.training.recipe import read_recipe
from touchd.model.training.weights import SCORES_NAME

DOCS = Path(__file__).parents[2] / "docs"


Tables = Callable[[], dict[str, str]]
PAGES: dict[str, Tables] = {
    "accuracy": lambda: {
        **accuracy.tables(read_scores(SHIPPED_MODEL.with_name(SCORES_NAME))),
        **others.tables(stored(others.FILE, others.Measured)),
    },
    "adapt": lambda: {
        **adapting.tables(stored(adapting.FILE, adapting.Measured)),
        **new_pad.tables(stored(new_pad.FILE, new_pad.Measured)),
    },
    "decision": lambda: {
        **decision.tables(stored(decision.FILE, decision.Measured)),
        **passing.curve_table(stored(passing.FILE, passing.Measured)),
    },
    "report": lambda: {
        **challenge.tables(Results(challenge.FILE)),
        **paper.tables(Results(paper.FILE)),
    },
    "speed": lambda: speed.tables(stored(speed.FILE, speed.Measured)),
    "sessions": lambda: {
        **tables.session_tables(Results(tables.FILE)),
        **tables.sensitivity_table(Results(tables.DETECTION_FILE)),
        **passing.tables(stored(passing.FILE, passing.Measured)),
    },
}


@pytest.mark.parametrize("name", PAGES)
def test_a_page_shows_the_stored_figures(name: str, tmp_path: Path) -> None:
    published, again = DOCS / f"{name}.md", tmp_path / "again.md"
    shutil.copy(published, again)
    shown = PAGES[name]()
    fill(again, shown)
    assert again.read_text(encoding="utf-8") == published.read_text(encoding="utf-8")
    assert {place for _, place, _ in PLACE.findall(published.read_text(encoding="utf-8"))} == set(shown)


@pytest.mark.parametrize("length", accuracy.LENGTHS)
def test_the_readme_shows_the_stored_scores(length: int) -> None:
    scores = read_scores(SHIPPED_MODEL.with_name(SCORES_NAME))
    readme = (DOCS.parent / "README.md").read_text(encoding="utf-8")
    row = next(line for line in readme.splitlines() if f"({length} frames)" in line)
    _, _, ours, _, *others, _ = (cell.strip(" *") for cell in row.split("|"))
    people = (scores.test, scores.second_study, scores.third_study, scores.new_pad)
    assert [ours, *others] == [percent(accuracy.at(each, length).accuracy) for each in people]


def test_adapting_was_measured_with_the_shipped_settings_on_everybody() -> None:
    measured = stored(adapting.FILE, adapting.Measured)
    people = [name for fold in read_recipe().folds for name in sorted(fold) if name not in adapting.FEW]
    expected = list(product(people, range(adapting.DRAWS), adapting.SHOTS))
    assert measured.settings == AdaptSettings()
    assert [(t.participant, t.draw, t.each) for t in measured.trials] == expected


def test_a_person_of_the_second_study_gains_with_every_recording() -> None:
    trials = stored(adapting.FILE, adapting.Measured).trials
    own = [t for t in trials if t.participant.startswith("R")]
    after = [np.mean([t.after for t in own if t.each == each]) for each in adapting.SHOTS]
    assert np.mean([t.before for t in own]) < after[0] < after[1] < after[2]


@pytest.mark.parametrize("path", [challenge.FILE, paper.FILE], ids=lambda path: path.stem)
def test_every_cell_says_which_command_commit_and_machine_made_it(path: Path) -> None:
    results = Results(path)
    assert results.find()
    for key in results.find():
        cell = results.cell(key)
        assert cell.command, key
        assert cell.commit, key
        assert "cores" in cell.machine, key


def test_a_cell_keeps_its_values_and_says_what_made_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(sys, "argv", ["/code/studies/__main__.py", "paper", "--haart", "/home/anna/haart"])
    results = Results(tmp_path / "new" / "paper.json")
    assert not results.has("a")
    results.put("a", {"accuracies": [0.5, 0.75]}, 12.34567)
    again = Results(tmp_path / "new" / "paper.json")
    assert again.get("a") == {"accuracies": [0.5, 0.75]}
    cell = again.cell("a")
    assert cell.seconds == 12.346
    assert cell.command == "studies paper --haart haart"
    assert "onnxruntime" in cell.machine


@pytest.mark.parametrize("content", ["", "{", "[]", '{"a": 1}', '{"a": {"values": {}}}'])
def test_a_damaged_file_of_results_is_refused_and_kept(tmp_path: Path, content: str) -> None:
    path = tmp_path / "paper.json"
    path.write_text(content)
    with pytest.raises(ResultsError, match=r"paper\.json") as raised:
        Results(path)
    assert "\n" not in str(raised.value)
    assert path.read_text() == content


PAGE = """\
# A title

Ours.

<!-- table: speed -->
old
<!-- end -->

<!-- table: size -->
<!-- end -->
End.
"""


def test_tables_replace_the_old_ones_in_their_places(tmp_path: Path) -> None:
    page = tmp_path / "page.md"
    page.write_text(PAGE)
    fill(page, {"speed": table(("network", "ms"), [("ours", 2), ("theirs", 9)])})
    filled = page.read_text()
    assert "Ours.\n\n<!-- table: speed -->\n\n| network | ms |\n|---|---|\n| ours | 2 |\n" in filled
    assert "<!-- table: size -->\n<!-- end -->\nEnd." in filled
    assert "old" not in filled


def test_a_table_without_its_place_is_refused(tmp_path: Path) -> None:
    page = tmp_path / "page.md"
    page.write_text(PAGE)
    with pytest.raises(PageError, match=r"page.md: .*weight"):
        fill(page, {"speed": "", "weight": ""})
    assert page.read_text() == PAGE
