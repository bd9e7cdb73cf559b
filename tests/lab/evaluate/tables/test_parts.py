"""The pieces that the tables are made of, against known answers."""

from __future__ import annotations

import math

import numpy as np
import pytest

from engine.compress.hvq import HvqConfig, Stage, quantize
from engine.compress.impact import measure_impact
from engine.errors import InputError
from engine.flows.embed.profiles import profile
from engine.flows.views.camera_rig import make_rig, measure_extent
from engine.flows.views.view_set import look
from engine.formats import read_model
from engine.lab.evaluate.intervals import share_interval
from engine.lab.evaluate.marked_scene import configure
from engine.lab.evaluate.summary import accuracy, mean_text, range_text, share_text, table
from engine.lab.evaluate.tables.part import printed
from engine.lab.evaluate.tables.sections.ablation import LINES, verdict
from engine.lab.evaluate.tables.sections.fig6 import knobs as knobs_of_figure_6
from engine.lab.evaluate.tables.tables_cells import STEPS, without
from engine.lab.evaluate.tables.tables_curves import effect
from engine.model import SH_C0
from engine.watermark import planning
from engine.watermark.planning import make_carriers
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
    points = [setting for knob in knobs_of_figure_6(False) for setting in knob.points.values()]
    for setting in [*points, *(s for line in LINES for s in (line.setting, line.base))]:
        configure(setting.profile, setting.changes)
        without(setting.without, HvqConfig())


# --- steps taken out -----------------------------------------------------------------------------------------


def test_mask_without_uncertainty_is_the_planners_without_it(monkeypatch: pytest.MonkeyPatch) -> None:
    model = read_model(PLANT).model.take(np.arange(0, 110_000, 20))
    views = look(model, make_rig(model, 2, 96, 96), lambda done: None)
    impact = measure_impact(model, views.views, views.images)
    taken = without("uncertainty mask", HvqConfig(cells=64))
    stages = taken.own_stages(model, impact.squared)
    assert stages is not None
    factor = taken.emphasis_on(impact)
    assert factor is not None
    assert factor.max() - factor.min() > 0.05, "the step does something on this model"
    made = planning.make_plan(stages, impact, None, factor)
    monkeypatch.setattr(planning, "uncertainty", lambda curvature: np.ones_like(curvature))
    expected = planning.make_plan(stages, impact)
    np.testing.assert_allclose(made.layout.amplitudes, expected.layout.amplitudes, rtol=1e-5)


def test_weights_without_uncertainty_split_cells_evenly() -> None:
    model = read_model(PLANT).model.take(np.arange(4_096))
    stages = without("uncertainty weights", HvqConfig(cells=64)).own_stages(model, np.linspace(0, 9, 4_096))
    assert stages is not None
    members = np.bincount(stages[0].labels)
    assert members.max() - members.min() <= 2
    radius = measure_extent(model).radius
    by_weight = np.bincount(quantize(model, np.linspace(0, 9, 4_096), radius, HvqConfig(cells=64))[0].labels)
    assert by_weight.max() - by_weight.min() > 20


def test_carriers_without_svd_are_the_axes() -> None:
    model = read_model(PLANT).model.take(np.arange(4_096))
    stages = without("svd", HvqConfig(cells=64)).own_stages(model, np.ones(4_096))
    assert stages is not None
    assert isinstance(stages[0], Stage)
    shown = 0.5 + SH_C0 * stages[0].codebook[:, :3]
    np.testing.assert_allclose(np.sort(shown, axis=1), np.tile([0.0, 0.0, 1.0], (64, 1)), atol=1e-6)
    directions = make_carriers(stages[0].codebook, np.random.default_rng(0).random(64)).directions
    np.testing.assert_allclose(np.sort(np.abs(directions), axis=1), np.tile([0.0, 0.0, 1.0], (3, 1)), atol=1e-5)


def test_steps_that_do_not_exist_are_refused() -> None:
    with pytest.raises(InputError, match="no step 'luck' can be taken out"):
        without("luck", HvqConfig())
    assert len(set(STEPS)) == len(STEPS)


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
    assert share_text(found).startswith("96.9 % (")
    assert accuracy([]) is None
    assert share_text(None) == ""


def test_a_table_is_columns_of_rows() -> None:
    made = table([{"a": 1, "b": 2.0}], "a", ("twice", lambda row: 2 * row["b"]), ("again", "a"), title="T")
    assert (made.columns, made.rows, made.title) == (["a", "twice", "again"], [[1, 4.0, 1]], "T")


def test_one_value_is_said_to_be_alone() -> None:
    assert mean_text([2.0]) == "2.0 (one)"
    assert mean_text([]) == ""
    assert mean_text([1.0, 3.0]).startswith("2.0 (")
    assert range_text([3.0, 1.0]) == "1 to 3"


def _rows(setting: str, factor: float, views: int = 8) -> list[dict[str, object]]:
    rng = np.random.default_rng(0)
    return [
        {
            "scene": "a",
            "setting": setting,
            "seed": seed,
            "kind": "picture",
            "view": view,
            "attack": attack,
            "z": factor * float(rng.uniform(10, 40)),
        }
        for seed in (0, 1)
        for view in range(views)
        for attack in ("none", "JPEG 10", "noise 0.1")
    ]


def test_effects_are_paired_by_place() -> None:
    rows = _rows("default", 1.0) + _rows("texture-0", 0.9, views=4)
    found = effect(rows, "texture-0", "default", "JPEG 10")
    assert found is not None
    line = next(line for line in LINES if line.setting.name == "texture-0")
    assert found.pairs == 8
    assert effect(rows, "default", "default", "none") is not None
    assert math.isclose(effect(rows, "default", "default", "none").percent, 0.0)  # type: ignore[union-attr]
    assert effect(rows, "default", "cells-1024", "none") is None
    assert verdict(line, _rows("default", 1.0)) == "not measured"


def test_a_constant_loss_is_found_whatever_the_views_differ_by() -> None:
    rows = _rows("default", 1.0) + _rows("texture-0", 0.9)
    found = effect(rows, "texture-0", "default", "noise 0.1")
    assert found is not None
    assert found.is_clear
    assert math.isclose(found.percent, -10.0, abs_tol=1e-9)
    assert math.isclose(found.low, found.high, abs_tol=1e-9)
    line = next(line for line in LINES if line.setting.name == "texture-0")
    rows += [
        {
            "scene": "a",
            "setting": name,
            "seed": 0,
            "kind": "marked",
            "z": 100.0,
            "gaussians_in": 10,
            "gaussians_out": left,
        }
        for name, left in (("default", 10), ("texture-0", 5))
    ]
    assert verdict(line, rows) == "picture -10 %; picture, JPEG 10 -10 %; picture, noise 0.1 -10 %; Gaussians -50 %"
