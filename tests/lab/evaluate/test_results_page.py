"""The page of results: what it says of bars, what it refuses, and that the committed page is what the files give."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from engine.errors import InputError
from engine.lab.evaluate.results_page import draw_page, main, read_results

DOCS = Path(__file__).parents[3] / "docs"
ENTRY: dict[str, Any] = {
    "what": "Crops",
    "command": "mark3dgs evaluate --suite table2",
    "seed": "default",
    "machine": "not recorded",
    "commit": "abc1234",
    "columns": ["kept", "z"],
    "rows": [["10 %", "225"]],
    "bars": [{"bar": "every bit", "measured": "100 %", "met": True}, {"bar": "z 300", "measured": "225", "met": False}],
}


def write(folder: Path, **changes: Any) -> Path:
    (folder / "01.json").write_text(json.dumps(ENTRY | changes))
    return folder


def test_misses_stand_above_all_tables(tmp_path: Path) -> None:
    page = draw_page(read_results(write(tmp_path)))
    assert page.index("| z 300 | 225 |") < page.index("| 10 % | 225 |") < page.index("every bit (100 %)")


def test_what_was_not_written_down_is_not_shown(tmp_path: Path) -> None:
    page = draw_page(read_results(write(tmp_path)))
    assert "`mark3dgs evaluate --suite table2`; seed default; commit abc1234. Bars met" in page
    assert "not recorded" not in page


@pytest.mark.parametrize(
    "changes", [{"rows": [["10 %"]]}, {"surprise": 1}, {"rows": [["10 %", "225", "3"]]}], ids=["short", "field", "long"]
)
def test_a_faulty_file_is_refused(changes: dict[str, Any], tmp_path: Path) -> None:
    with pytest.raises(InputError):
        read_results(write(tmp_path, **changes))


def test_an_empty_folder_is_refused_and_leaves_the_page(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    page = tmp_path / "page.md"
    page.write_text("old")
    assert main([str(tmp_path), str(page), str(tmp_path / "rates.json")]) == 2
    assert page.read_text() == "old"
    assert str(tmp_path) in capsys.readouterr().err


def test_the_committed_page_is_what_its_files_give(tmp_path: Path) -> None:
    page = tmp_path / "page.md"
    assert main([str(DOCS / "results"), str(page), str(tmp_path / "rates.json")]) == 0
    assert page.read_text(encoding="utf-8") == (DOCS / "RESULTS.md").read_text(encoding="utf-8")
