"""The walk along the edge of the verdict: it works where it can, asks no more than it may, gains little on a mark."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from engine.formats import write_model
from engine.formats.model_reading import read_model
from engine.lab.evaluate.bench import oracle
from engine.lab.evaluate.bench.oracle import _hop, _Oracle, _Way, measure_oracle
from engine.model import Float32, GaussianModel
from engine.watermark.claim import Verdict


def _way(gaussians: int) -> _Way:
    plant = read_model("tests/data/plant.splat").model
    model = plant.take(np.arange(0, len(plant), 12)[:gaussians])
    rng = np.random.default_rng(1)
    far = model.with_(
        means=(model.means + rng.normal(size=model.means.shape)).astype(np.float32),
        log_scales=(model.log_scales + rng.normal(size=model.means.shape)).astype(np.float32),
    )
    return _Way(model, far, rng.permutation(len(model)), np.full((len(model), 9), 0.01, np.float32))


def _plane(way: _Way, calls: list[int]) -> Any:
    """A detector that says yes before a plane across colours, and counts."""
    normal = np.random.default_rng(2).normal(size=(len(way.marked), 3))
    back = np.argsort(way.order)

    def ask(suspect: GaussianModel) -> Any:
        calls.append(1)
        gone = float((normal * (suspect.take(back).means - way.marked.means)).sum())
        return SimpleNamespace(claim=SimpleNamespace(verdict=Verdict.MARKED if gone < 0.5 else Verdict.INCONCLUSIVE))

    return ask


def _length(place: Float32) -> float:
    return float(np.linalg.norm(place))


def test_few_dimensions_are_walked_and_the_budget_is_kept() -> None:
    way, calls = _way(6), list[int]()
    detector = _Oracle(_plane(way, calls), way, 600)
    start = way.start()
    if detector.claims(start):
        start = -start
    place = detector.edge(start)
    first, rng, step = _length(place), np.random.default_rng(3), 0
    while not detector.spent:
        step += 1
        place = _hop(detector, place, step, rng)
        assert cast(Any, _plane(way, [])(way.model(place))).claim.verdict is Verdict.INCONCLUSIVE
    assert len(calls) == detector.count == 600
    assert _length(place) < 0.5 * first
    assert detector.claims(start)
    assert len(calls) == 600


def test_the_far_model_lies_at_the_start_of_the_walk() -> None:
    way = _way(50)
    there = way.model(way.start())
    np.testing.assert_allclose(there.means, way.far.take(way.order).means, atol=1e-5)
    np.testing.assert_allclose(there.log_scales, way.far.take(way.order).log_scales, atol=1e-5)


@pytest.mark.long
@pytest.mark.slow
def test_a_mark_gives_little_away(tmp_path: object, monkeypatch: pytest.MonkeyPatch) -> None:
    plant = read_model("tests/data/plant.splat").model
    path = f"{tmp_path}/thin.ply"
    write_model(plant.take(np.arange(0, len(plant), 24)), path)
    monkeypatch.setattr(oracle, "PROBES", 6)
    rows = measure_oracle(path, 24, 1, "fast")
    assert rows[0]["asked"] <= oracle.HALVINGS + 1
    assert rows[-1]["asked"] == 24
    assert all(row["z"] < 15 for row in rows)
    assert rows[-1]["psnr_db"] < rows[0]["psnr_db"] + 1.0
