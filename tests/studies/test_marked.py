"""Tables are filled into marked places of a hand-written page."""

from pathlib import Path

import pytest

from touchd.model.studies.marked import PageError, fill, table

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
SPEED = table(("network", "ms"), [("ours", 2), ("theirs", 9)])


@pytest.fixture
def page(tmp_path: Path) -> Path:
    path = tmp_path / "page.md"
    path.write_text(PAGE)
    return path


def test_tables_replace_the_old_ones_in_their_places(page: Path) -> None:
    fill(page, {"speed": SPEED, "size": "7 KB"})
    filled = page.read_text()
    assert "Ours.\n\n<!-- table: speed -->\n\n| network | ms |\n| --- | --- |\n| ours | 2 |\n" in filled
    assert "<!-- table: size -->\n\n7 KB\n\n<!-- end -->\nEnd." in filled
    assert "old" not in filled
    fill(page, {"speed": SPEED, "size": "7 KB"})
    assert page.read_text() == filled


@pytest.mark.parametrize("tables", [{"speed": ""}, {"speed": "", "size": "", "weight": ""}])
def test_a_table_without_its_place_is_refused(page: Path, tables: dict[str, str]) -> None:
    with pytest.raises(PageError, match=r"page.md: .*(size|weight)"):
        fill(page, tables)
    assert page.read_text() == PAGE
