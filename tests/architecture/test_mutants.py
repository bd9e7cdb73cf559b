"""The table of `make mutants` follows the code: its lines are there, its tests too."""

from __future__ import annotations

import ast

from tests.architecture.tree import ROOT
from tests.mutants.table import find, mutated, read_table


def test_every_line_of_the_table_is_there_once() -> None:
    """Where this fails, a line has changed: give the table its new text (and break it in the same way)."""
    lost = []
    for mutant in read_table():
        try:
            find(ROOT, mutant)
        except LookupError as error:
            lost.append(str(error))
    assert not lost


def test_every_mutation_is_a_program_and_its_tests_exist() -> None:
    table = read_table()
    assert len(table) > 75
    assert {mutant.part for mutant in table} == {
        "catalogue",
        "cli",
        "compress",
        "registration",
        "watermark",
        "flows",
        "kernels",
        "records",
        "service",
        "pictures",
        "raster",
        "statistics",
        "numerics",
        "formats",
    }
    for mutant in table:
        path, text = mutated(ROOT, mutant)
        assert text != (ROOT / path).read_text(encoding="utf-8"), mutant
        ast.parse(text)
    assert not [test for mutant in table for test in mutant.tests if not (ROOT / test).exists()]
