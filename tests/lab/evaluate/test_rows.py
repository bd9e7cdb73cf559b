"""The moves that reports are made of, and cells made of functions."""

from engine.lab.evaluate.study import Bar, Cell
from engine.lab.evaluate.summary import distinct, grouped, listed, picked, table
from tests.lab.evaluate.cells import square

ROWS = [
    {"scene": "a", "seed": 1, "z": 2.0},
    {"scene": "b", "seed": 1, "z": 3.0, "note": "x"},
    {"scene": "a", "seed": 2, "z": 4.0},
]


def test_rows_are_picked_and_grouped_in_their_order() -> None:
    assert picked(ROWS, scene="a", seed=2) == [ROWS[2]]
    assert picked(ROWS, note=None) == [ROWS[0], ROWS[2]]
    assert grouped(ROWS, "scene") == {"a": [ROWS[0], ROWS[2]], "b": [ROWS[1]]}
    assert distinct(ROWS, "scene", "seed") == [("a", 1), ("b", 1), ("a", 2)]


def test_tables_of_fields_formats_and_functions() -> None:
    shown = table(ROWS[:2], "scene", "note", ("z", "{z:.1f} of {seed}"), ("twice", lambda r: 2 * r["z"]), title="T")
    assert shown.title == "T"
    assert shown.columns == ["scene", "note", "z", "twice"]
    assert shown.rows == [["a", None, "2.0 of 1", 4.0], ["b", "x", "3.0 of 1", 6.0]]
    assert listed([{"a": 1, "b": 2}]).rows == [[1, 2]]
    assert listed([]).columns == []


def test_a_cell_of_a_function_runs_it() -> None:
    cell = Cell.of("four", square, value=2.0)
    assert cell == Cell("four", "tests.lab.evaluate.cells:square", {"value": 2.0})
    assert cell.run() == [{"value": 2.0, "square": 4.0}]


def test_faults_are_listed_and_miss_the_bar() -> None:
    assert Bar.without("sound", "all", "2 of 2", []) == Bar("sound", "all", "2 of 2", True)
    assert Bar.without("sound", "all", "1 of 2", ["b"]) == Bar("sound", "all", "1 of 2; b", False)
