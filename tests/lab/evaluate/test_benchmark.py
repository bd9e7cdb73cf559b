"""The protocols that compare methods: their attacks and views, an extractor of one's own, refusals."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
import pytest

from engine.errors import InputError
from engine.flows.views.camera_rig import measure_extent
from engine.formats import read_model
from engine.lab.evaluate.benchmark import benchmark, flymark, msvs
from engine.lab.evaluate.benchmark.methods import BITS, Found, find_method, mark_subject
from engine.lab.evaluate.cell_runner import run_cells
from engine.lab.evaluate.study import Options, Row
from engine.lab.sim.attack_cost import Cost
from engine.lab.sim.suite import SUITE
from engine.model import SH_C0, Camera, Float32, GaussianModel
from engine.watermark.messages import Signs
from tests.lab.evaluate.pieces import PLANT, write_piece

ROOT = Path(__file__).parents[3]
HERE = "tests.lab.evaluate.test_benchmark"


class Remembering:
    """A blind reader that says what it was given: by how many bits wrong does the number of Gaussians say."""

    name, informed = "remembering", False

    def embed(self, model: GaussianModel, message: Signs, seed: int) -> GaussianModel:
        self.count, self.message = len(model), message
        return model.with_dc(model.sh[:, 0] + np.float32(0.001))

    def read_model(self, suspect: GaussianModel) -> Found:
        lost = min(BITS, round(2 * BITS * abs(len(suspect) / self.count - 1.0)))
        return Found(np.where(np.arange(BITS) < lost, -self.message, self.message))

    def read_picture(self, picture: Float32, camera: Camera | None) -> None:
        return None


class Short(Remembering):
    """Reads too few bits."""

    def read_model(self, suspect: GaussianModel) -> Found:
        return Found(self.message[:8])


class Needing:
    """Cannot be called without arguments."""

    def __init__(self, weights: str) -> None:
        self.weights = weights


class Half:
    """Marks, and reads nothing."""

    name = "half"

    def embed(self, model: GaussianModel, message: Signs, seed: int) -> None:
        return None


class Mute(Remembering):
    """Marks nothing."""

    def embed(self, model: GaussianModel, message: Signs, seed: int) -> None:  # type: ignore[override]
        return None


@pytest.mark.parametrize(
    ("name", "said"),
    [
        ("qimm", "no method is called 'qimm': name ours, qim"),
        (":Extractor", "no method is called"),
        ("no_such_module:X", "'no_such_module' cannot be imported: ModuleNotFoundError"),
        (f"{HERE}:Missing", "has no class 'Missing'"),
        (f"{HERE}:HERE", "has no class 'HERE'"),
        (f"{HERE}:Needing", "without arguments: TypeError"),
        (f"{HERE}:Half", "has no informed, read_model, read_picture"),
    ],
)
def test_a_wrong_method_is_named(name: str, said: str) -> None:
    with pytest.raises(InputError, match=said):
        find_method(name)


def test_a_module_of_the_current_folder_is_found(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "my_mark.py").write_text(f"from {HERE} import Remembering as Mine\n")
    (tmp_path / "my_broken_mark.py").write_text("1 / 0\n")
    monkeypatch.chdir(tmp_path)
    assert find_method("my_mark:Mine").name == "remembering"
    with pytest.raises(InputError, match="cannot be imported: ZeroDivisionError"):
        find_method("my_broken_mark:Mine")


def test_the_class_on_the_page_reads_its_bits(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    page = (ROOT / "docs" / "BENCHMARK.md").read_text()
    (tmp_path / "my_module.py").write_text(page.split("```python\n")[1].split("```")[0])
    monkeypatch.chdir(tmp_path)
    subject = mark_subject("my_module:Extractor", str(write_piece(tmp_path, 0.05)), 3)
    assert subject.read_model(subject.marked) == (32, True, None)
    right, claimed, _ = subject.read_model(subject.original) or (32, True, None)
    assert (right < 26, claimed) == (True, False)
    assert f"{len(SUITE)} attacks" in page


def test_what_a_method_gives_back_is_checked(tmp_path: Path) -> None:
    piece = str(write_piece(tmp_path, 0.01))
    subject = mark_subject(f"{HERE}:Short", piece, 0)
    with pytest.raises(InputError, match=r"expected 32 bits of \+1 and -1"):
        subject.read_model(subject.marked)
    with pytest.raises(InputError, match="gave a NoneType back"):
        mark_subject(f"{HERE}:Mute", piece, 0)


def test_an_own_method_goes_through_every_attack(tmp_path: Path) -> None:
    options = Options((str(write_piece(tmp_path, 0.02)),), quick=True, methods=(f"{HERE}:Remembering",))
    rows = run_cells(benchmark.STUDY.cells(options), tmp_path / "cells")
    found = {(row["on"], row["attack"]): (row["right"], row["outcome"]) for row in rows if row["what"] == "attack"}
    assert found["model", "none"] == (32, "held")
    assert found["model", "prune random 20 %"][0] == 19  # 0.4 of 32 bits lost
    assert found["model", "prune random 20 %"][1] in ("removed", "ruined")
    assert found["image", "JPEG 10"] == (None, None)
    report = benchmark.STUDY.report(rows, options)
    # This method knows the message and claims unmarked models. The benchmark reports that first.
    (bar,) = report.bars
    assert (bar.met, bar.measured) == (False, "2 of 2; unmarked model; another owner's model")
    (totals,), (lines,) = (section.tables for section in report.sections)
    assert [row[:2] for row in totals.rows] == [["remembering", "blind"]]
    assert lines.rows[0][0] == "prune random 20 %"


@pytest.mark.parametrize(
    ("claimed", "look", "outcome"), [(True, 10.0, "held"), (False, 27.0, "removed"), (False, 26.9, "ruined")]
)
def test_an_attack_removes_only_what_keeps_its_look(claimed: bool, look: float, outcome: str) -> None:
    assert benchmark.judge((20, claimed, None), Cost(look, look, 0.9, 1.0, None))["outcome"] == outcome


def test_flymark_severities_do_what_they_say() -> None:
    model = read_model(PLANT).model.take(np.arange(0, 100_000, 10))
    rng = np.random.default_rng(0)
    fade, shake, colors = (flymark.FAMILIES[name][0] for name in ("opacity noise", "position noise", "color bits"))
    middle = (model.opacities > 0.2) & (model.opacities < 0.7)
    ratio = fade(model, 0.1, rng).opacities[middle] / model.opacities[middle]
    assert float(ratio.std()) == pytest.approx(0.1, rel=0.1)
    rho = np.quantile(np.linalg.norm(model.means - measure_extent(model).center, axis=1), 0.95)
    assert float((shake(model, 0.01, rng).means - model.means).std()) == pytest.approx(0.01 * rho, rel=0.02)
    rounded = 0.5 + SH_C0 * colors(model, 4.0, rng).sh[:, 0].astype(np.float64)
    assert np.abs(15 * rounded - np.round(15 * rounded)).max() < 1e-4
    for attack, severities, _ in flymark.FAMILIES.values():
        assert len(attack(model, severities[0], rng)) > 0


def test_the_area_counts_severities_alike() -> None:
    def rows(*right: int) -> list[Row]:
        return [{"step": step, "right": value} for step, value in enumerate(right, 1)]

    assert flymark.area_of(rows(32), rows(32, 32, 32)) == 1.0
    assert flymark.area_of(rows(32), rows(16, 16)) == pytest.approx((0.75 + 0.5) / 2)
    assert flymark.area_of(rows(32), [*rows(32), *rows(16)]) == pytest.approx(0.875)  # two seeds of one severity


def _flymark(right: int) -> Sequence[Row]:
    about = {"scene": "s", "method": "ours", "informed": True, "claimed": True}
    one = [{**about, "family": name, "step": 1, "severity": 1.0, "right": 32} for name in flymark.FAMILIES]
    return [{**about, "family": flymark.CLEAN, "step": 0, "right": 32}, *one[:-1], {**one[-1], "right": right}]


def _msvs(claims: int) -> Sequence[Row]:
    about = {"scene": "s", "method": "ours", "informed": True, "camera": "known", "span": 1.0, "right": 32, "z": 9.0}
    return [{**about, "claimed": number < claims} for number in range(100)] + [{**about, "right": None}]


@pytest.mark.parametrize(
    ("study", "rows", "met"),
    [
        (flymark.STUDY, lambda: _flymark(32), True),
        (flymark.STUDY, lambda: _flymark(31), False),
        (msvs.STUDY, lambda: _msvs(95), True),
        (msvs.STUDY, lambda: _msvs(94), False),
    ],
)
def test_bars_are_met_on_their_own_side(study: msvs.Study, rows: Callable[[], list[Row]], met: bool) -> None:
    (bar,) = study.report(rows(), Options(())).bars
    assert bar.met == met


@pytest.mark.parametrize("span", [2.0, 0.25])
def test_shells_are_covered_evenly(span: float) -> None:
    model = read_model(PLANT).model
    extent = measure_extent(model)
    views = msvs.shell_views(model, span, 40, 3)
    away = np.array([camera.position for camera in views]) - extent.center
    distance = np.linalg.norm(away, axis=1)
    assert np.ptp(distance) < 1e-5 * distance[0]
    np.testing.assert_array_equal(np.sort(np.floor(20 * (1 - away[:, 1] / distance))), np.arange(40))  # equal areas
    sine = extent.radius / distance[0]
    edge = views[0].K[0, 0] * sine / np.sqrt(1.0 - sine**2) / (msvs.SIDE / 2)
    assert edge == pytest.approx(span, rel=1e-3)  # sides of the picture
    for camera in views[::8]:
        x, y, z = camera.K @ (camera.viewmat[:3, :3] @ extent.center + camera.viewmat[:3, 3])
        assert (x / z, y / z) == (pytest.approx(msvs.SIDE / 2, abs=0.01), pytest.approx(msvs.SIDE / 2, abs=0.01))


@pytest.mark.long
def test_ours_and_a_blind_baseline_go_through_the_protocols(tmp_path: Path) -> None:
    options = Options((str(write_piece(tmp_path)),), quick=True, methods=("ours", "qim"))
    rows = run_cells(flymark.STUDY.cells(options), tmp_path / "flymark")
    areas = {method: [r for r in rows if r["method"].startswith(method)] for method in ("ours", "QIM")}
    assert min(row["right"] for row in areas["ours"]) == 32
    assert all(row["claimed"] for row in areas["ours"])
    right = {row["family"]: row["right"] for row in areas["QIM"]}
    assert (right["clean"], right["reorder"]) == (32, 32)
    assert right["color bits"] < 26, right  # four bits a channel are coarser than its lattices
    assert flymark.STUDY.report(rows, options).bars[0].met
    pictures = run_cells(msvs.STUDY.cells(options), tmp_path / "msvs")
    assert all(row["claimed"] for row in pictures if row["method"] == "ours")
    assert {row["right"] for row in pictures if row["method"].startswith("QIM")} == {None}
