"""What attacks cost, and the chains of them."""

from __future__ import annotations

import math

import numpy as np
import pytest

from engine.errors import InputError
from engine.lab.sim.attack_cost import image_cost, model_cost
from engine.lab.sim.attacks import find_attack, model_attack
from engine.lab.sim.suite import SUITE, Trial, apply_chain
from engine.model import GaussianModel


def test_nothing_costs_nothing_and_moving_costs_nothing(model: GaussianModel) -> None:
    same = model_cost(model, model, views=2, size=96)
    assert math.isinf(same.psnr)
    assert (same.ssim, same.coverage) == (pytest.approx(1.0), 1.0)
    moved = model_attack("shuffle").apply(model_attack("similarity").apply(model, 4.0, rng=1), rng=1)
    cost = model_cost(model, moved, views=2, size=96)
    assert cost.psnr > 55
    assert cost.worst_psnr <= cost.psnr


def test_cost_rises_with_strength_and_sees_holes(model: GaussianModel) -> None:
    looks = [
        model_cost(model, model_attack("noise_dc").apply(model, s, rng=1), views=2, size=96).psnr for s in (0.01, 0.1)
    ]
    assert looks[0] > looks[1] + 15
    piece = model_attack("crop").apply(model, 0.4, rng=1)
    cost = model_cost(model, piece, views=3, size=96)
    assert 0.2 < cost.coverage < 0.8
    assert cost.covered_psnr is not None
    assert cost.covered_psnr > cost.psnr + 1
    gone = model.with_(opacity_logits=np.full(500, -9.0, np.float32))
    assert model_cost(model, gone, views=2, size=96).covered_psnr is None
    with pytest.raises(InputError, match="0 views"):
        model_cost(model, model, views=0)


def test_cost_of_a_picture_is_its_psnr(image: np.ndarray) -> None:
    noisy = find_attack("noise_image").apply(image, 0.1, rng=1)
    cost = image_cost(image, noisy)
    assert cost.psnr == pytest.approx(20, abs=1)
    assert cost.covered_psnr == pytest.approx(cost.psnr)


def test_the_suite_is_sound_data() -> None:
    labels = [trial.label for trial in SUITE]
    assert len(set(labels)) == len(labels) > 60
    for trial in SUITE:
        for name, strength in trial.chain:
            attack = find_attack(name)
            assert attack.kind == ("image" if trial.kind == "image" else "model")
            assert isinstance(strength, str) == isinstance(attack.default, str)
        if trial.reading == "as_code":
            assert any(len(find_attack(name).readings) == 2 for name, _ in trial.chain)


def test_every_step_of_a_chain_is_taken_in_its_reading(model: GaussianModel) -> None:
    trial = Trial("", (("crop", 0.2), ("noise_dc", 0.1)), "", reading="as_code")
    out = apply_chain(model, trial, 7)
    by_hand = model_attack("crop").apply(model, 0.2, rng=np.random.default_rng((7, 0)), reading="as_code")
    by_hand = model_attack("noise_dc").apply(by_hand, 0.1, rng=np.random.default_rng((7, 1)))
    np.testing.assert_array_equal(out.sh, by_hand.sh)
    kept = apply_chain(model, trial, 7, skip=("crop",))
    assert len(kept) == 500
