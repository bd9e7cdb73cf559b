"""Each model attack does what its strength says, measured on the parameters."""

from __future__ import annotations

import numpy as np
import pytest

from engine.errors import InputError
from engine.flows.views.camera_rig import measure_extent
from engine.lab.sim.attacks import model_attack
from engine.lab.sim.model_placement import foreign_scene
from engine.lab.sim.model_population import clone, impact
from engine.model import GaussianModel, look_at

ATTRIBUTES = ("means", "log_scales", "quats", "opacity_logits", "sh")


def run(
    name: str, model: GaussianModel, strength: float | None = None, seed: int = 0, **options: object
) -> GaussianModel:
    return model_attack(name).apply(model, strength, rng=seed, **options)


def origins(model: GaussianModel, attacked: GaussianModel) -> np.ndarray:
    """Index in the model of each Gaussian of the attacked one, by its log scales, which are all different."""
    index = {row.tobytes(): i for i, row in enumerate(model.log_scales)}
    return np.array([index[row.tobytes()] for row in attacked.log_scales])


def assert_taken(model: GaussianModel, attacked: GaussianModel) -> np.ndarray:
    """Every Gaussian is one of the model's, unchanged; returns which."""
    index = origins(model, attacked)
    for name in ATTRIBUTES:
        np.testing.assert_array_equal(getattr(attacked, name), getattr(model, name)[index])
    return index


def similarity_of(model: GaussianModel, moved: GaussianModel) -> tuple[float, np.ndarray, np.ndarray]:
    """Scale, rotation and center shift by Procrustes on the centers, which must explain them."""
    a, b = model.means.astype(np.float64), moved.means.astype(np.float64)
    a0, b0 = a - a.mean(axis=0), b - b.mean(axis=0)
    u, _, vt = np.linalg.svd(b0.T @ a0)
    R = u @ np.diag([1, 1, np.linalg.det(u @ vt)]) @ vt
    factor = float(np.sqrt((b0**2).sum() / (a0**2).sum()))
    np.testing.assert_allclose(b0, factor * a0 @ R.T, atol=1e-5 * np.abs(b).max())
    return factor, R, b.mean(axis=0) - a.mean(axis=0)


def angle_of(R: np.ndarray) -> float:
    return float(np.degrees(np.arccos(np.clip((np.trace(R) - 1) / 2, -1, 1))))


@pytest.mark.parametrize("degrees", [5.0, 30.0, 180.0])
def test_rotate_turns_about_the_centre(model: GaussianModel, degrees: float) -> None:
    moved = run("rotate", model, degrees)
    factor, R, _ = similarity_of(model, moved)
    assert factor == pytest.approx(1.0, abs=1e-5)
    assert angle_of(R) == pytest.approx(degrees, abs=0.05)
    center = measure_extent(model).center
    np.testing.assert_allclose(moved.means - center, (model.means - center) @ R.T, atol=2e-3)  # the center itself stays
    assert np.abs(moved.quats - model.quats).max() > 0.01
    assert np.abs(moved.sh[:, 1:] - model.sh[:, 1:]).max() > 0.01
    np.testing.assert_array_equal(moved.sh[:, 0], model.sh[:, 0])
    np.testing.assert_array_equal(moved.opacity_logits, model.opacity_logits)


@pytest.mark.parametrize("factor", [0.1, 0.75, 10.0])
def test_scale_scales_centres_and_sizes(model: GaussianModel, factor: float) -> None:
    moved = run("scale", model, factor)
    measured, R, _ = similarity_of(model, moved)
    assert measured == pytest.approx(factor, rel=1e-4)
    assert angle_of(R) < 0.05
    np.testing.assert_allclose(moved.scales, factor * model.scales, rtol=1e-5)
    np.testing.assert_allclose(measure_extent(moved).center, measure_extent(model).center, atol=1e-4)


@pytest.mark.parametrize("strength", [0.1, 10.0])
def test_translate_shifts_by_radii(model: GaussianModel, strength: float) -> None:
    moved = run("translate", model, strength)
    factor, _, shift = similarity_of(model, moved)
    assert factor == pytest.approx(1.0, abs=1e-5)
    assert np.linalg.norm(shift) == pytest.approx(strength * measure_extent(model).radius, rel=1e-3)
    np.testing.assert_array_equal(moved.quats, model.quats)


def test_similarity_draws_all_three(model: GaussianModel) -> None:
    factors, angles, shifts = [], [], []
    for seed in range(40):
        factor, R, shift = similarity_of(model, run("similarity", model, 3.0, seed))
        factors.append(factor)
        angles.append(angle_of(R))
        shifts.append(np.linalg.norm(shift))
    assert 1 / 3 - 1e-3 <= min(factors) < 0.6
    assert 1.7 < max(factors) <= 3 + 1e-3
    assert np.mean(angles) == pytest.approx(126, abs=20)  # uniform over rotations: 90 + 360 / pi^2 degrees
    assert 0.5 < np.mean(shifts) < 5


def test_shuffle_changes_the_order_and_nothing_else(model: GaussianModel) -> None:
    index = assert_taken(model, run("shuffle", model))
    np.testing.assert_array_equal(np.sort(index), np.arange(len(model)))
    assert (index != np.arange(len(model))).mean() > 0.9
    few = assert_taken(model, run("shuffle", model, 0.1))
    assert 0.05 < (few != np.arange(len(model))).mean() <= 0.1


def test_crop_keeps_a_connected_piece(model: GaussianModel) -> None:
    index = assert_taken(model, run("crop", model, 0.1))
    assert len(index) == 50
    assert (np.diff(index) > 0).all()
    distance = np.linalg.norm(model.means[:, None] - model.means[index][None], axis=-1)  # (N, 50)
    # One of the survivors is the seed: no lost Gaussian is nearer to it than the farthest survivor.
    lost = np.setdiff1d(np.arange(len(model)), index)
    assert (distance[lost].min(axis=0) >= distance[index].max(axis=0)).any()


@pytest.mark.parametrize("share", [0.2, 0.9])
def test_prune_random_removes_its_share(model: GaussianModel, share: float) -> None:
    index = assert_taken(model, run("prune_random", model, share))
    assert len(index) == round((1 - share) * len(model))
    assert (np.diff(index) > 0).all()
    kept, all_ = model.opacities[index].mean(), model.opacities.mean()
    assert abs(kept - all_) < 5 * model.opacities.std() / np.sqrt(len(index))


def test_prune_opacity_removes_the_most_transparent(model: GaussianModel) -> None:
    index = assert_taken(model, run("prune_opacity", model, 0.3))
    assert len(index) == 350
    lost = np.setdiff1d(np.arange(len(model)), index)
    assert model.opacity_logits[lost].max() <= model.opacity_logits[index].min()


def test_prune_low_impact_removes_what_is_not_seen(model: GaussianModel) -> None:
    # Half as many tiny Gaussians in the middle of the solid: opaque, but hidden and small.
    model = model.with_(opacity_logits=model.opacity_logits + 5.0)
    hidden = model.take(np.arange(250))
    center = model.means.mean(axis=0)
    hidden = hidden.with_(
        means=center + 0.1 * (hidden.means - center),
        log_scales=hidden.log_scales - 4.0,
        opacity_logits=np.full(250, 12.0),
    )
    both = GaussianModel(*(np.concatenate([getattr(hidden, n), getattr(model, n)]) for n in ATTRIBUTES))
    # From all six sides: generated views look from above and would call the underside unseen too.
    sides = [
        look_at(center + 4 * sign * axis, center, (1, 2, 3), 80.0, 96, 96) for sign in (-1, 1) for axis in np.eye(3)
    ]
    index = assert_taken(both, run("prune_low_impact", both, 0.3, cameras=sides))
    assert len(index) == 525
    assert (index < 250).sum() < 30
    assert (assert_taken(both, run("prune_opacity", both, 0.3)) < 250).sum() == 250


def test_impact_needs_cameras_and_follows_them(model: GaussianModel) -> None:
    from engine.flows.views.camera_rig import make_rig

    cameras = make_rig(model, 2, 64, 64)
    one, two = impact(model, cameras[:1]), impact(model, cameras)
    np.testing.assert_allclose(two, one + impact(model, cameras[1:]), rtol=1e-6)
    assert (two >= 0).all()
    assert two.max() > 1
    given = assert_taken(model, run("prune_low_impact", model, 0.5, cameras=cameras))
    assert two[given].min() >= np.median(two)
    with pytest.raises(InputError, match="camera"):
        run("prune_low_impact", model, 0.5, cameras=[])


@pytest.mark.parametrize("reading", ["literal", "as_code"])
def test_clone_appends_copies_of_its_share(model: GaussianModel, reading: str) -> None:
    cloned = run("clone", model, 0.5, reading=reading)
    assert len(cloned) == 750
    index = origins(model, cloned)
    np.testing.assert_array_equal(index[:500], np.arange(500))
    assert len(set(index[500:])) == 250
    for name in ("log_scales", "quats", "sh"):
        np.testing.assert_array_equal(getattr(cloned, name), getattr(model, name)[index])
    np.testing.assert_array_equal(cloned.means[:500], model.means)
    moved = np.abs(cloned.means - model.means[index])[500:].max(axis=1)
    if reading == "as_code":
        assert (moved == 0).all()
        np.testing.assert_array_equal(cloned.opacity_logits, model.opacity_logits[index])
    else:
        assert (moved > 0).all()
        assert np.median(moved) < 0.2 * model.scales.min()


def test_cloned_pairs_let_as_much_light_through_as_one(model: GaussianModel) -> None:
    logits = np.linspace(-12.0, 15.0, len(model)).astype(np.float32)
    cloned = clone(model.with_(opacity_logits=logits), 1.0, np.random.default_rng(0))
    both = cloned.opacity_logits.astype(np.float64)
    np.testing.assert_array_equal(both[:500], both[500:])
    through = 2 * np.log(1 / (1 + np.exp(both[:500])))  # log of (1 - o')^2
    np.testing.assert_allclose(through, -np.logaddexp(0, logits.astype(np.float64)), rtol=2e-5)


@pytest.mark.parametrize(
    ("name", "noisy"), [("noise_means", {"means"}), ("noise_colors", {"sh"}), ("noise_all", set(ATTRIBUTES))]
)
def test_noise_touches_its_attributes_with_their_own_std(model: GaussianModel, name: str, noisy: set[str]) -> None:
    out = run(name, model, 0.1)
    for attribute in ATTRIBUTES:
        was, now = getattr(model, attribute), getattr(out, attribute)
        error = (now - was).astype(np.float64)
        if attribute not in noisy:
            np.testing.assert_array_equal(was, now)
        elif attribute == "sh":  # each coefficient on its own
            expected = 0.1 * np.sqrt(was.var(axis=0).mean(axis=1))
            np.testing.assert_allclose(error.std(axis=(0, 2)), expected, rtol=0.12)
        elif attribute == "quats":
            np.testing.assert_allclose(np.linalg.norm(now, axis=1), 1.0, atol=1e-6)
            assert 0.03 < error.std() < 0.06  # 0.1 of 0.5, less what normalizing takes away
        else:
            expected = 0.1 * np.sqrt(was.var(axis=0).mean())
            assert error.std() == pytest.approx(expected, rel=0.1)


def test_drop_sh_cuts_the_bands(model: GaussianModel) -> None:
    for degree in (0, 1):
        out = run("drop_sh", model, degree)
        assert out.sh_degree == degree
        np.testing.assert_array_equal(out.sh, model.sh[:, : (degree + 1) ** 2])
    np.testing.assert_array_equal(run("drop_sh", model, 3).sh, model.sh)


@pytest.mark.parametrize("bits", [2, 4, 8])
def test_quantize_leaves_that_many_values(model: GaussianModel, bits: int) -> None:
    out = run("quantize", model, bits)
    for attribute in ("means", "log_scales", "opacity_logits", "sh"):
        was = getattr(model, attribute).reshape(len(model), -1)
        now = getattr(out, attribute).reshape(len(model), -1)
        step = (was.max(axis=0) - was.min(axis=0)) / (2**bits - 1)
        assert (np.abs(now - was) <= 0.5 * step + 1e-5).all()
        assert all(len(np.unique(column)) <= 2**bits for column in now.T)
        assert np.abs(now - was).max() > 0.3 * step.min()
    np.testing.assert_allclose(np.linalg.norm(out.quats, axis=1), 1.0, atol=1e-6)


def test_quantize_keeps_a_constant_property(model: GaussianModel) -> None:
    flat = model.with_(opacity_logits=np.full(len(model), 1.25))
    np.testing.assert_array_equal(run("quantize", flat, 4).opacity_logits, flat.opacity_logits)


def test_merge_into_contains_the_moved_model(model: GaussianModel) -> None:
    merged = run("merge_into", model, 3.0)
    assert len(merged) == 2000
    own = merged.take(np.arange(1500, 2000))
    factor, R, shift = similarity_of(model, own)
    assert angle_of(R) > 1
    np.testing.assert_allclose(own.scales, factor * model.scales, rtol=1e-4)
    np.testing.assert_array_equal(own.sh[:, 0], model.sh[:, 0])
    host, placed = measure_extent(merged.take(np.arange(1500))), measure_extent(own)
    assert 0.1 < placed.radius / host.radius < 0.7
    assert np.linalg.norm(placed.center - host.center) < 1.2 * host.radius
    assert np.linalg.norm(shift) > 0


def test_merge_into_a_given_scene(model: GaussianModel) -> None:
    other = foreign_scene(model, 4000, np.random.default_rng(9)).with_(sh=np.zeros((4000, 1, 3)))
    merged = run("merge_into", model, 2.0, other=other)  # a connected piece of it
    assert len(merged) == 1500
    piece = set(map(bytes, merged.means[:1000]))
    assert piece < set(map(bytes, other.means))
    assert (merged.sh[:1000] == 0).all()
    assert merged.sh_degree == model.sh_degree
    whole = run("merge_into", model, 100.0, other=other)
    np.testing.assert_array_equal(whole.means[:4000], other.means)
    with pytest.raises(InputError, match="empty"):
        run("merge_into", model, 1.0, other=other.take(np.arange(0)))


def test_foreign_scene_copies_nothing_but_looks_alike_in_numbers(model: GaussianModel) -> None:
    other = foreign_scene(model, 5000, np.random.default_rng(1))
    for attribute in ("log_scales", "opacity_logits"):
        mine, theirs = getattr(model, attribute), getattr(other, attribute)
        assert abs(theirs.mean() - mine.mean()) < 0.1 * mine.std() + 0.02
        assert float(theirs.std()) == pytest.approx(float(mine.std()), rel=0.2)
    for attribute in ATTRIBUTES:
        mine, theirs = (getattr(m, attribute).reshape(len(m), -1) for m in (model, other))
        equal = len(set(mine[:, 0].tolist()) & set(theirs[:, 0].tolist()))
        assert equal < 0.02 * len(model)  # float32 values do meet by chance
    assert measure_extent(other).radius > 1.5 * measure_extent(model).radius
