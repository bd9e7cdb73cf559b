"""Attacks that move a whole model; not one Gaussian of it is lost.

All are pure functions `(model, strength, rng) -> model`. A moved model looks as before from a camera moved
alike: quaternions and SH turn with the centres.
"""

import numpy as np

from engine.errors import InputError
from engine.flows.views.camera_rig import measure_extent
from engine.lab.sim.attack import Attacks
from engine.model import ATTRIBUTES, Float64, GaussianModel
from engine.numerics.similarity import MIRROR, mirror_model, quaternion_to_rotation, transform_model

__all__ = ["ATTACKS", "join", "random_rotation", "unit"]

ATTACKS: Attacks[GaussianModel] = Attacks("model")

# What turns the mirror image in the plane x = 0 into that of another axis: half a turn about the third.
_FROM_X = {"x": np.eye(3), "y": np.diag([-1.0, -1.0, 1.0]), "z": np.diag([-1.0, 1.0, -1.0])}


@ATTACKS.add(
    "turn the whole model about its centre, random axis", "degrees", 30.0, (1, 5, 15, 30, 60, 90, 120, 150, 180)
)
def rotate(model: GaussianModel, strength: float, rng: np.random.Generator) -> GaussianModel:
    axis = rng.standard_normal(3)
    half = np.radians(strength) / 2.0
    quat = np.concatenate([[np.cos(half)], np.sin(half) * axis / np.linalg.norm(axis)])
    return _move(model, 1.0, quaternion_to_rotation(quat), np.zeros(3))


@ATTACKS.as_code("rotate", "share of a random matrix", 1.0, (0.01, 0.1, 0.3, 1.0), "[0, 1]")
def mix_axes(model: GaussianModel, strength: float, rng: np.random.Generator) -> GaussianModel:
    """GaussianMarker's "rotate": centres times a random normal 3x3 matrix, at 1; below, a blend with the identity.

    Neither orthogonal nor applied to rotations or colours: as the code runs it.
    """
    matrix = (1.0 - strength) * np.eye(3) + strength * rng.standard_normal((3, 3))
    return model.with_(means=(model.means.astype(np.float64) @ matrix).astype(np.float32))


@ATTACKS.add(
    "scale the whole model about its centre",
    "factor",
    0.75,
    (0.99, 1.1, 0.9, 0.75, 1.5, 0.5, 2.0, 0.25, 4.0, 0.1, 10.0),
    "(0, inf)",
)
def scale(model: GaussianModel, strength: float, rng: np.random.Generator) -> GaussianModel:
    return _move(model, strength, np.eye(3), np.zeros(3))


@ATTACKS.add(
    "shift the whole model in a random direction", "robust radii of the model", 1.0, (0.01, 0.1, 0.5, 1, 3, 10, 100)
)
def translate(model: GaussianModel, strength: float, rng: np.random.Generator) -> GaussianModel:
    direction = rng.standard_normal(3)
    return _move(model, 1.0, np.eye(3), strength * direction / np.linalg.norm(direction))


@ATTACKS.as_code("translate", "std of each point's shift, scene units", 1.0, (0.01, 0.1, 1.0), "[0, inf)")
def scatter(model: GaussianModel, strength: float, rng: np.random.Generator) -> GaussianModel:
    """GaussianMarker's "translate": every point by a shift of its own, N(0, `strength`^2) scene units."""
    shifts = rng.standard_normal(model.means.shape, dtype=np.float32)
    return model.with_(means=model.means + np.float32(strength) * shifts)


@ATTACKS.add(
    "random rotation, scale and shift together",
    "largest scale factor, up or down",
    2.0,
    (1, 1.1, 1.5, 2, 4, 10),
    "[1, inf)",
)
def similarity(model: GaussianModel, strength: float, rng: np.random.Generator) -> GaussianModel:
    """Any rotation, a scale log-uniform in 1/`strength` .. `strength`, a shift of the order of the radius."""
    limit = np.log(strength)
    factor = float(np.exp(rng.uniform(-limit, limit)))
    return _move(model, factor, random_rotation(rng), rng.standard_normal(3))


@ATTACKS.add("turn one axis over, as wrong handedness does", "axis through the centre: x, y or z", "x", ("x", "y", "z"))
def mirror(model: GaussianModel, strength: str, rng: np.random.Generator) -> GaussianModel:
    if strength not in _FROM_X:
        raise InputError(f"mirror: no axis is called {strength!r}; there are {', '.join(_FROM_X)}")
    extent, image = measure_extent(model), mirror_model(model)
    turn = _FROM_X[strength]
    return transform_model(image, 1.0, turn, extent.center - turn @ (extent.center * MIRROR))


@ATTACKS.add("write the Gaussians in another order", "share of Gaussians moved", 1.0, (0.01, 0.1, 0.5, 1.0), "[0, 1]")
def shuffle(model: GaussianModel, strength: float, rng: np.random.Generator) -> GaussianModel:
    """The rest keep their places."""
    order = np.arange(len(model))
    chosen = np.sort(rng.permutation(len(model))[: round(strength * len(model))])
    order[chosen] = rng.permutation(chosen)
    return model.take(order)


def join(*models: GaussianModel) -> GaussianModel:
    """All models in one, in their order; SH padded with zeros to the highest of their degrees. Antialiased where all
    of them are."""
    width = max(model.sh.shape[1] for model in models)
    parts = [m.with_(sh=np.pad(m.sh, ((0, 0), (0, width - m.sh.shape[1]), (0, 0)))) for m in models]
    whole = {name: np.concatenate([getattr(part, name) for part in parts]) for name in ATTRIBUTES}
    return GaussianModel(**whole, antialiased=all(model.antialiased for model in models))


def _move(model: GaussianModel, factor: float, rotation: Float64, shift: Float64) -> GaussianModel:
    """Turn and scale about the centre, then shift by `shift` radii."""
    extent = measure_extent(model)
    t = extent.center - factor * rotation @ extent.center + extent.radius * shift
    return transform_model(model, factor, rotation, t)


def random_rotation(rng: np.random.Generator) -> Float64:
    """Uniform over all rotations."""
    return quaternion_to_rotation(unit(rng.standard_normal(4)))


def unit(vectors: Float64) -> Float64:
    """(..., D) vectors at length 1."""
    return np.asarray(vectors / np.linalg.norm(vectors, axis=-1, keepdims=True))
