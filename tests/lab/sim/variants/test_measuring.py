from __future__ import annotations

import numpy as np
import pytest

from engine.errors import InputError
from engine.lab.sim.attacks import IMAGE_ATTACKS, MODEL_ATTACKS
from engine.lab.sim.variants.variant_table import (
    DISC_MODEL_CASES,
    DISC_PICTURE_CASES,
    MODEL_CASES,
    PICTURE_CASES,
    fidelity_for,
)
from engine.numerics.image_metrics import psnr


def test_a_mark_of_that_fidelity_costs_what_was_asked() -> None:
    rng = np.random.default_rng(0)
    truth = [rng.uniform(0.3, 0.7, (64, 64, 3)).astype(np.float32) for _ in range(3)]
    before = [
        t + np.float32(s) * rng.standard_normal(t.shape).astype(np.float32)
        for t, s in zip(truth, (0.01, 0.02, 0.04), strict=True)
    ]
    mark = fidelity_for(truth, before, 20.0, drop=0.1)
    noise = np.float32(10 ** (-mark / 20))
    after = [b + noise * rng.standard_normal(b.shape).astype(np.float32) for b in before]
    drop = np.mean([psnr(t, b) - psnr(t, a) for t, b, a in zip(truth, before, after, strict=True)])
    assert 0.07 < drop <= 0.11
    assert fidelity_for(truth, before, 60.0) == 60.0


def test_a_variant_without_loss_has_no_such_fidelity() -> None:
    picture = np.full((8, 8, 3), 0.5, dtype=np.float32)
    with pytest.raises(InputError, match="equals its truth"):
        fidelity_for([picture], [picture], 47.0)


def test_the_cases_are_attacks_that_exist() -> None:
    assert {name for _, name, _ in MODEL_CASES + DISC_MODEL_CASES} <= set(MODEL_ATTACKS)
    assert {name for _, name, _ in PICTURE_CASES + DISC_PICTURE_CASES} <= set(IMAGE_ATTACKS)
