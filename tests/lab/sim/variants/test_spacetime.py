from __future__ import annotations

import numpy as np
import pytest

from engine.errors import InputError
from engine.model import SH_C0
from engine.scenes.spacetime import SpacetimeModel
from tests.reference.spacetime import gaussian_at


def random_clip(n: int, seed: int) -> SpacetimeModel:
    rng = np.random.default_rng(seed)
    return SpacetimeModel(
        rng.standard_normal((n, 3)),
        rng.uniform(-5, -2, (n, 3)),
        3 * rng.standard_normal((n, 4)),
        rng.normal(0, 3, n),
        rng.uniform(-0.1, 1.1, (n, 3)),
        rng.uniform(0, 1, n),
        rng.uniform(-4, 1, n),
        rng.standard_normal((n, 9)),
        rng.standard_normal((n, 4)),
    )


@pytest.fixture
def few() -> SpacetimeModel:
    return random_clip(40, 0)


@pytest.mark.parametrize("time", [0.0, 0.37, 1.0])
def test_a_moment_is_what_the_paper_says(few: SpacetimeModel, time: float) -> None:
    model = few.at(time)
    for i in range(len(few)):
        opacity, mean, quat = gaussian_at(few, i, time)
        np.testing.assert_allclose(model.means[i], mean, rtol=1e-5, atol=1e-5)
        np.testing.assert_allclose(model.quats[i], quat, atol=1e-6)
        assert model.opacities[i] == pytest.approx(opacity, rel=1e-5, abs=1e-30)
    np.testing.assert_allclose(0.5 + SH_C0 * model.sh[:, 0], few.colors, atol=1e-6)


def test_opacity_survives_fading_to_nothing_and_back(few: SpacetimeModel) -> None:
    """At its temporal center a Gaussian has its own logit; far away the logit is the logarithm of what is left."""
    one = SpacetimeModel(
        few.means[:1],
        few.log_scales[:1],
        few.quats[:1],
        np.array([14.0]),
        few.colors[:1],
        np.array([0.5]),
        np.array([np.log(0.1)]),
        few.motion[:1],
        few.omega[:1],
    )
    assert one.at(0.5).opacity_logits[0] == pytest.approx(14.0, abs=1e-5)
    assert one.at(0.0).opacity_logits[0] == pytest.approx(-25.0, abs=1e-4)
    assert one.at(9.5).opacity_logits[0] == -80.0


def test_canonical_shows_everything_at_its_best(few: SpacetimeModel) -> None:
    canonical = few.canonical()
    np.testing.assert_array_equal(canonical.means, few.means)
    np.testing.assert_array_equal(canonical.opacity_logits, few.opacity_logits)
    for time in (0.1, 0.6):
        assert (few.at(time).opacities <= canonical.opacities * (1 + 1e-6)).all()
    np.testing.assert_allclose(np.linalg.norm(canonical.quats, axis=1), 1.0, atol=1e-6)


def test_persistence_is_the_mean_of_the_temporal_basis(few: SpacetimeModel) -> None:
    times = np.linspace(0, 1, 2001)[:, None]
    exact = np.exp(-(((times - few.trbf_center) / np.exp(few.trbf_scale)) ** 2)).mean(axis=0)
    np.testing.assert_allclose(few.persistence(), exact, atol=0.02)


def test_displaced_at_all_times_as_the_canonical_model_is(few: SpacetimeModel) -> None:
    still = few.canonical()
    like = still.with_(
        means=still.means + np.float32(0.2),
        log_scales=still.log_scales - np.float32(0.3),
        sh=still.sh + np.float32(0.1),
    )
    moved = few.displaced(like)
    for time in (0.0, 0.8):
        a, b = few.at(time), moved.at(time)
        np.testing.assert_allclose(b.sh - a.sh, 0.1, atol=1e-5)
        np.testing.assert_allclose(b.means - a.means, 0.2, atol=1e-5)
        np.testing.assert_allclose(b.log_scales - a.log_scales, -0.3, atol=1e-5)
        np.testing.assert_array_equal(a.quats, b.quats)
        np.testing.assert_array_equal(a.opacity_logits, b.opacity_logits)
        np.testing.assert_array_equal(few.at(time, like).means, b.means)


def test_digest_sees_every_array(few: SpacetimeModel) -> None:
    digests = {few.digest()}
    for name in few.__dataclass_fields__:
        arrays = {field: getattr(few, field) for field in few.__dataclass_fields__}
        arrays[name] = arrays[name] + np.float32(1e-3)
        digests.add(SpacetimeModel(**arrays).digest())
    assert len(digests) == 10


def test_wrong_shapes_and_moments_are_named(few: SpacetimeModel) -> None:
    arrays = {field: getattr(few, field) for field in few.__dataclass_fields__}
    with pytest.raises(InputError, match=r"motion has shape \(40, 6\)"):
        SpacetimeModel(**{**arrays, "motion": few.motion[:, :6]})
    with pytest.raises(InputError, match="nan"):
        few.at(float("nan"))
