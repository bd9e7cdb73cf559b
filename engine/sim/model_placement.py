"""Attacks that move a whole model or put it among others; not one Gaussian of it is lost.

All are pure functions `(model, strength, rng) -> model`. A moved model looks as before from a camera moved
alike: quaternions and SH turn with the centres.
"""

import numpy as np

from engine.errors import InputError
from engine.model import Float32, Float64, GaussianModel
from engine.numerics.similarity import quaternion_to_rotation, transform_model
from engine.sim.attack import check_positive
from engine.sim.model_population import crop

__all__ = ["foreign_scene", "join", "merge_into", "rotate", "scale", "shuffle", "similarity", "translate"]

FOREIGN_SIZE = 3.0
"""Radius of the synthetic foreign scene, in radii of the model."""

PLACED_SIZE = (0.15, 0.6)
"""Radius of the placed model, in radii of the scene it is put in; log-uniform."""


def rotate(model: GaussianModel, strength: float, rng: np.random.Generator) -> GaussianModel:
    """Proper rotation by `strength` degrees about a random axis through the model's centre."""
    axis = rng.standard_normal(3)
    half = np.radians(_finite(strength, "angle")) / 2.0
    quat = np.concatenate([[np.cos(half)], np.sin(half) * axis / np.linalg.norm(axis)])
    return _move(model, 1.0, quaternion_to_rotation(quat), np.zeros(3))


def scale(model: GaussianModel, strength: float, rng: np.random.Generator) -> GaussianModel:
    """Scaling about the model's centre by the factor `strength`."""
    return _move(model, check_positive(strength, "scale factor"), np.eye(3), np.zeros(3))


def translate(model: GaussianModel, strength: float, rng: np.random.Generator) -> GaussianModel:
    """Shift in a random direction by `strength` robust radii of the model."""
    direction = rng.standard_normal(3)
    shift = _finite(strength, "shift") * direction / np.linalg.norm(direction)
    return _move(model, 1.0, np.eye(3), shift)


def similarity(model: GaussianModel, strength: float, rng: np.random.Generator) -> GaussianModel:
    """Any rotation, a scale log-uniform in 1/`strength` .. `strength`, a shift of the order of the radius."""
    if not strength >= 1:
        raise InputError(f"largest scale factor must be at least 1, got {strength}")
    limit = np.log(_finite(strength, "largest scale factor"))
    factor = float(np.exp(rng.uniform(-limit, limit)))
    return _move(model, factor, _random_rotation(rng), rng.standard_normal(3))


def shuffle(model: GaussianModel, strength: float, rng: np.random.Generator) -> GaussianModel:
    """Random order for a random share `strength` of the Gaussians; the rest keep their places."""
    if not 0 <= strength <= 1:
        raise InputError(f"share of shuffled Gaussians must lie in [0, 1], got {strength}")
    order = np.arange(len(model))
    chosen = np.sort(rng.permutation(len(model))[: round(strength * len(model))])
    order[chosen] = rng.permutation(chosen)
    return model.take(order)


def merge_into(
    model: GaussianModel, strength: float, rng: np.random.Generator, *, other: GaussianModel | None = None
) -> GaussianModel:
    """The model, randomly placed inside a foreign scene of `strength` times as many Gaussians.

    Parameters
    ----------
    strength : float
        Foreign Gaussians per Gaussian of the model.
    other : GaussianModel, optional
        The foreign scene; a connected piece of it when it is larger than asked for, all of it when not.
        Without it a synthetic one, see `foreign_scene`.

    Returns
    -------
    GaussianModel
        Foreign Gaussians first, then the model's in their own order, rotated, moved and scaled to 0.15 to 0.6
        radii of the foreign scene; SH padded with zeros to the higher of the two degrees.

    Raises
    ------
    InputError
        If the strength is not positive or the foreign scene is empty.
    """
    from engine.pipeline.rigs import measure_extent

    wanted = max(1, round(check_positive(strength, "foreign Gaussians per Gaussian") * len(model)))
    if other is not None and len(other) == 0:
        raise InputError("the foreign scene is empty")
    if other is None:
        other = foreign_scene(model, wanted, rng)
    elif wanted < len(other):
        other = crop(other, wanted / len(other), rng)
    own, host = measure_extent(model), measure_extent(other)
    factor = np.exp(rng.uniform(*np.log(PLACED_SIZE))) * host.radius / own.radius
    rotation = _random_rotation(rng)
    direction = rng.standard_normal(3)
    place = host.center + host.radius * 0.7 * rng.random() * direction / np.linalg.norm(direction)
    placed = transform_model(model, float(factor), rotation, place - factor * rotation @ own.center)
    return join(other, placed)


def join(first: GaussianModel, second: GaussianModel) -> GaussianModel:
    """Both models in one file, in that order; SH padded with zeros to the higher of the two degrees."""
    width = max(first.sh.shape[1], second.sh.shape[1])

    def padded(sh: Float32) -> Float32:
        return sh if sh.shape[1] == width else np.pad(sh, ((0, 0), (0, width - sh.shape[1]), (0, 0)))

    return GaussianModel(
        np.concatenate([first.means, second.means]),
        np.concatenate([first.log_scales, second.log_scales]),
        np.concatenate([first.quats, second.quats]),
        np.concatenate([first.opacity_logits, second.opacity_logits]),
        np.concatenate([padded(first.sh), padded(second.sh)]),
    )


def foreign_scene(model: GaussianModel, count: int, rng: np.random.Generator) -> GaussianModel:
    """A synthetic scene of `count` Gaussians that has nothing to do with the model but resembles it in kind.

    Textured sheets in random places of a ball of three radii of the model. Sizes, opacities and colours
    follow normal laws with the model's own mean and spread, so that no threshold on one attribute tells the
    two apart; no value is copied from the model.
    """
    from engine.pipeline.rigs import measure_extent

    radius = FOREIGN_SIZE * measure_extent(model).radius
    sheets = max(4, count // 1000)
    sheet = rng.integers(sheets, size=count)
    centers = rng.standard_normal((sheets, 3))
    centers *= (radius * np.cbrt(rng.random(sheets)) / np.linalg.norm(centers, axis=1))[:, None]
    half_sizes = radius * rng.uniform(0.05, 0.3, (sheets, 3)) * np.array([1.0, 1.0, 0.02])
    turns = quaternion_to_rotation(_unit(rng.standard_normal((sheets, 4))))
    local = rng.uniform(-1.0, 1.0, (count, 3))  # in the sheet's own frame
    means = centers[sheet] + np.einsum("nij,nj->ni", turns[sheet], half_sizes[sheet] * local)

    def alike(values: Float32, size: tuple[int, ...]) -> Float32:
        """Normal samples with the mean and spread of each column of the values."""
        mean, spread = values.mean(axis=0, dtype=np.float64), values.std(axis=0, dtype=np.float64)
        samples = rng.standard_normal(size, dtype=np.float32)
        samples *= spread.astype(np.float32)
        samples += mean.astype(np.float32)
        return samples

    base = alike(model.sh[:, 0], (sheets, 3))
    texture = 0.4 * model.sh[:, 0].astype(np.float64).std(axis=0)
    waves = np.sin(local @ rng.normal(0.0, 4.0, (3, 3)) + rng.uniform(0, 2 * np.pi, 3))
    sh = np.empty((count, *model.sh.shape[1:]), dtype=np.float32)
    sh[:, 0] = base[sheet] + texture * (waves + 0.3 * rng.standard_normal((count, 3)))
    sh[:, 1:] = alike(model.sh[:, 1:], sh[:, 1:].shape)
    return GaussianModel(
        means.astype(np.float32),
        alike(model.log_scales, (count, 3)),
        _unit(rng.standard_normal((count, 4))).astype(np.float32),
        alike(model.opacity_logits, (count,)),
        sh,
    )


def _move(model: GaussianModel, factor: float, rotation: Float64, shift: Float64) -> GaussianModel:
    """Turn and scale about the centre, then shift by `shift` radii."""
    from engine.pipeline.rigs import measure_extent

    extent = measure_extent(model)
    t = extent.center - factor * rotation @ extent.center + extent.radius * shift
    return transform_model(model, factor, rotation, t)


def _random_rotation(rng: np.random.Generator) -> Float64:
    """Uniform over all rotations."""
    return quaternion_to_rotation(_unit(rng.standard_normal(4)))


def _unit(vectors: Float64) -> Float64:
    return np.asarray(vectors / np.linalg.norm(vectors, axis=-1, keepdims=True))


def _finite(value: float, what: str) -> float:
    if not np.isfinite(value):
        raise InputError(f"{what} must be finite, got {value}")
    return float(value)
