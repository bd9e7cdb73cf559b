"""The pieces that the tables are made of, against known answers."""

from __future__ import annotations

import pytest

from engine.errors import InputError
from engine.flows.embed.profiles import profile
from engine.lab.evaluate.intervals import share_interval
from engine.lab.evaluate.marked_scene import configure
from engine.lab.evaluate.study import Options
from engine.lab.evaluate.summary import accuracy, table
from engine.lab.evaluate.tables import as_paper
from engine.lab.evaluate.tables.part import printed
from engine.lab.evaluate.tables.tables_study import STUDY
from tests.lab.evaluate.tables.test_study import PLANT

# --- settings ------------------------------------------------------------------------------------------------


def test_settings_change_what_they_name_and_nothing_else() -> None:
    config = configure(
        "fast", {"views": 3}, {"plan": {"texture_exponent": 0.0}, "quantize": {"residual_codes": [8, 4]}}
    )
    plain = profile("fast")
    assert config.views == 3
    assert config.plan.texture_exponent == 0.0
    assert config.plan.balance_rounds == plain.plan.balance_rounds
    assert config.quantize.residual_codes == (8, 4)
    assert configure("fast") == plain


def test_unknown_settings_are_refused() -> None:
    with pytest.raises(InputError, match="PlanConfig has no field 'texture'"):
        configure("fast", {"plan": {"texture": 0.0}})


def test_every_setting_of_the_tables_exists() -> None:
    settings = [cell.arguments["setting"] for cell in STUDY.cells(Options((PLANT,))) if "setting" in cell.arguments]
    settings += [s for cell in as_paper.cells(Options((PLANT,))) if (s := cell.arguments["arguments"].get("setting"))]
    changed = [setting for setting in settings if isinstance(setting, dict)]
    assert len(changed) > 40
    for setting in changed:
        configure(setting["profile"], setting["changes"])


# --- the paper's numbers -------------------------------------------------------------------------------------


def test_the_papers_numbers_by_table_and_row() -> None:
    ours = {row["bits"]: row for row in printed("table1") if row["system"] == "Mark3DGS"}
    assert (ours[32]["bit_accuracy"], ours[32]["psnr"], ours[32]["lpips"]) == (98.79, 28.52, 0.0209)
    assert len(printed("table1")) == 18
    attacks = {row["system"]: row for row in printed("table2")}
    assert (attacks["GuardSplat"]["jpeg"], attacks["Mark3DGS"]["prune"]) == (87.29, 90.27)
    assert {row["system"]: row["training_seconds"] for row in printed("table3")}["HiDDeN+3DGS"] == 148 * 60 + 16
    assert {row["setting"]: row["500"] for row in printed("table5")}["clean+key"] == 53.71
    assert printed("table6")[0]["psnr"] is None


# --- words and comparisons -----------------------------------------------------------------------------------


def test_accuracy_counts_bits_and_whole_readings() -> None:
    found = accuracy([{"right": 32, "bits": 32}, {"right": 30, "bits": 32}])
    assert found is not None
    assert found.share == 62 / 64
    assert (found.low, found.high) == share_interval(62, 64)
    assert (found.whole, found.readings) == (1, 2)
    assert str(found).startswith("96.88 % (")
    assert accuracy([]) is None


def test_a_table_is_columns_of_rows() -> None:
    made = table([{"a": 1, "b": 2.0}], "a", ("twice", lambda row: 2 * row["b"]), ("again", "a"), title="T")
    assert (made.columns, made.rows, made.title) == (["a", "twice", "again"], [[1, 4.0, 1]], "T")
