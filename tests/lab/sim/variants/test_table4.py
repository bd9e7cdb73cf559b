"""The row of Table 4: its numbers are the metrics', its readings the claims'."""

from __future__ import annotations

import json
from types import SimpleNamespace

import numpy as np
import pytest

from engine.errors import InputError
from engine.lab.sim.multiscale_ssim import ms_ssim_distance
from engine.lab.sim.variants.variant_table import measure_variant
from engine.numerics.image_metrics import psnr
from engine.watermark.claim import Verdict


def views(std: float, seed: int) -> list[np.ndarray]:
    rng = np.random.default_rng(seed)
    y, x = np.mgrid[:180, :190]
    scene = np.stack([0.5 + 0.2 * np.sin(x / (5 + c)) * np.cos(y / 7) for c in range(3)], axis=-1)
    return [(scene + std * rng.standard_normal(scene.shape)).astype(np.float32) for _ in range(2)]


def verification(accuracy: float) -> SimpleNamespace:
    claim = SimpleNamespace(
        route="model", bit_accuracy=accuracy, z=9.0, log10_false_claim=-17.0, verdict=Verdict.MARKED
    )
    return SimpleNamespace(claim=claim)


def test_a_row_holds_what_was_measured() -> None:
    truth, before = views(0.0, 0), views(0.05, 1)
    after = [b + n for b, n in zip(before, views(0.01, 2), strict=True)]
    after = [(a - t).astype(np.float32) for a, t in zip(after, truth, strict=True)]
    row = measure_variant(
        "x", truth, before, after, {"none": lambda: verification(1.0), "jpeg": lambda: verification(0.75)}
    )
    assert row.psnr_before == pytest.approx(np.mean([psnr(t, b) for t, b in zip(truth, before, strict=True)]))
    assert row.psnr_after == pytest.approx(np.mean([psnr(t, a) for t, a in zip(truth, after, strict=True)]))
    assert row.psnr_drop == pytest.approx(row.psnr_before - row.psnr_after)
    assert 0.1 < row.psnr_drop < 0.3  # 10 log10(1 + 0.01^2 / 0.05^2) = 0.17
    assert row.distance_after > row.distance_before > 0
    expected = [ms_ssim_distance(t, a) for t, a in zip(truth, after, strict=True)]
    assert row.distance_after == pytest.approx(np.mean(expected))
    assert row.psnr_of_mark == min(psnr(b, a) for b, a in zip(before, after, strict=True))
    assert [(r.case, r.bit_accuracy) for r in row.readings] == [("none", 1.0), ("jpeg", 0.75)]
    plain = json.loads(json.dumps(row.to_json()))
    assert plain["psnr_drop"] == row.psnr_drop
    assert plain["readings"][1]["verdict"] == "marked"


def test_unequal_views_are_refused() -> None:
    with pytest.raises(InputError, match="'x' needs equally many views"):
        measure_variant("x", views(0, 0), views(0, 0), views(0, 0)[:1], {})
    with pytest.raises(InputError, match="views"):
        measure_variant("x", [], [], [], {})
