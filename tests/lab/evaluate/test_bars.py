"""Each bar of a study has rows just inside it and rows just outside it: it tells them apart, the right way round."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import pytest

from engine.lab.evaluate.cost import cost_study as cost
from engine.lab.evaluate.null import null_study as null
from engine.lab.evaluate.null.null_rates import LOG10_THRESHOLDS, Rates
from engine.lab.evaluate.perceptual import perceptual_study as perceptual
from engine.lab.evaluate.steganalysis import steganalysis_study as steganalysis
from engine.lab.evaluate.study import Bar, Options
from engine.lab.evaluate.tables.parts import attack_bars


def _null(claims: int, keys: int) -> Sequence[Bar]:
    return null._null_bars([], [], Rates("all", keys, (0,) * (len(LOG10_THRESHOLDS) - 1) + (claims,)))


def _table2(on: str, attack: str, right: int) -> Sequence[Bar]:
    row = {"on": on, "reading": "literal", "attack": attack, "bits": 10_000, "right": right}
    return attack_bars([row], Options(()))


def _cost(embed: float, verify_model: float, verify_picture: float) -> Sequence[Bar]:
    """All sizes cost the same, so the fitted line does too."""
    times = {"stages": {"all": embed}, "verify_model_s": verify_model, "verify_picture_s": verify_picture}
    return cost._bars("plant", [{"axis": "gaussians", "size": n, **times} for n in (100_000, 250_000, 500_000)])


def _learned(auc: float) -> Sequence[Bar]:
    known = {"form": "floats", "low": 0.0, "high": 1.0, "classifier": "svm", "scene": "plant"}
    return steganalysis._learned_bars([{**known, "auc": auc}])


def _fusion(auc: float) -> Sequence[Bar]:
    return [steganalysis._fusion_bar({"auc": auc, "low": 0.0, "high": 1.0, "views": 9})]


def _perceptual(psnr: float, ssim: float) -> Sequence[Bar]:
    row = {"profile": "fast", "target_db": 60.0, "target_ssim": 1.0}
    good = {**row, "psnr": 60.0, "ssim": 1.0}
    return perceptual._bars([good, {**row, "psnr": psnr, "ssim": ssim}])


SIDES: dict[str, tuple[Callable[[], Sequence[Bar]], str, bool]] = {
    "no claim": (lambda: _null(0, 1_000_000), "claims at 1e-9", True),
    "one claim": (lambda: _null(1, 1_000_000), "claims at 1e-9", False),
    "enough keys": (lambda: _null(0, 1_000_000), "wrong keys tried", True),
    "a key too few": (lambda: _null(0, 999_999), "wrong keys tried", False),
    "picture at the bar": (lambda: _table2("picture", "jpeg", 9_990), "32 bits, picture", True),
    "picture below": (lambda: _table2("picture", "jpeg", 9_989), "32 bits, picture", False),
    "model, all bits": (lambda: _table2("model", "prune", 10_000), "32 bits, model", True),
    "model, a bit wrong": (lambda: _table2("model", "prune", 9_999), "32 bits, model", False),
    "embed in time": (lambda: _cost(14.9, 9.0, 9.0), "plant: embed fast", True),
    "embed late": (lambda: _cost(15.1, 1.0, 1.0), "plant: embed fast", False),
    "model in time": (lambda: _cost(99.0, 2.9, 9.0), "plant: verify a model", True),
    "model late": (lambda: _cost(1.0, 3.1, 1.0), "plant: verify a model", False),
    "picture in time": (lambda: _cost(99.0, 9.0, 2.9), "plant: verify a picture", True),
    "picture late": (lambda: _cost(1.0, 1.0, 3.1), "plant: verify a picture", False),
    "learned at chance": (lambda: _learned(0.515), "Learned detector", True),
    "learned above": (lambda: _learned(0.525), "Learned detector", False),
    "learned below": (lambda: _learned(0.475), "Learned detector", False),
    "fusion at chance": (lambda: _fusion(0.485), "StegExpose's fusion", True),
    "fusion above": (lambda: _fusion(0.525), "StegExpose's fusion", False),
    "PSNR at the bar": (lambda: _perceptual(47.0, 0.9), "PSNR", True),
    "PSNR below": (lambda: _perceptual(46.99, 1.0), "PSNR", False),
    "SSIM at the bar": (lambda: _perceptual(30.0, 0.998), "SSIM", True),
    "SSIM below": (lambda: _perceptual(60.0, 0.9979), "SSIM", False),
}


@pytest.mark.parametrize("side", SIDES)
def test_a_bar_is_met_on_its_own_side_only(side: str) -> None:
    bars, what, met = SIDES[side]
    (bar,) = [bar for bar in bars() if bar.what.startswith(what)]
    assert bar.met == met
