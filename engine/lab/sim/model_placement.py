"""Attacks that move a whole model, put it among others, send it through a trade format, or bend it out of shape.

All are pure functions `(model, strength, rng) -> model`, and lose no Gaussian. A moved model looks as before from a
camera moved alike: quaternions and SH turn with the centers.
"""

import numpy as np

from engine.errors import InputError
from engine.flows.views.camera_rig import measure_extent
from engine.lab.sim.attack import Attacks
from engine.lab.sim.model_population import crop
from engine.lab.sim.physics import deformations
from engine.model import Float32, Float64, GaussianModel, joined
from engine.numerics.similarity import MIRROR, mirror_model, quaternion_to_rotation, transform_model

__all__ = ["ATTACKS", "foreign_scene", "join"]


ATTACKS: Attacks[GaussianModel] = Attacks("model")

# What turns the mirror image in the plane x = 0 into that of another axis: half a turn about the third.
_FROM_X = {"x": np.eye(3), "y": np.diag([-1.0, -1.0, 1.0]), "z": np.diag([-1.0, 1.0, -1.0])}


@ATTACKS.add(
    "turn the whole model about its center, random axis", "degrees", 30.0, (1, 5, 15, 30, 60, 90, 120, 150, 180)
)
def rotate(model: GaussianModel, strength: float, rng: np.random.Generator) -> GaussianModel:
    axis = rng.standard_normal(3)
    half = np.radians(strength) / 2.0
    quat = np.concatenate([[np.cos(half)], np.sin(half) * axis / np.linalg.norm(axis)])
    return _move(model, 1.0, quaternion_to_rotation(quat), np.zeros(3))


@ATTACKS.as_code("rotate", "share of a random matrix", 1.0, (0.01, 0.1, 0.3, 1.0), "[0, 1]")
def mix_axes(model: GaussianModel, strength: float, rng: np.random.Generator) -> GaussianModel:
    """GaussianMarker's "rotate": centers times a random normal 3x3 matrix, at 1; below, a blend with the identity.

    Neither orthogonal nor applied to rotations or colors: as the code runs it.
    """
    matrix = (1.0 - strength) * np.eye(3) + strength * rng.standard_normal((3, 3))
    return model.with_(means=(model.means.astype(np.float64) @ matrix).astype(np.float32))


@ATTACKS.add(
    "scale the whole model about its center",
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


@ATTACKS.add("turn one axis over, as wrong handedness does", "axis through the center: x, y or z", "x", ("x", "y", "z"))
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
    return joined(models)


def _move(model: GaussianModel, factor: float, rotation: Float64, shift: Float64) -> GaussianModel:
    """Turn and scale about the center, then shift by `shift` radii."""
    extent = measure_extent(model)
    t = extent.center - factor * rotation @ extent.center + extent.radius * shift
    return transform_model(model, factor, rotation, t)


def random_rotation(rng: np.random.Generator) -> Float64:
    """Uniform over all rotations."""
    return quaternion_to_rotation(unit(rng.standard_normal(4)))


def unit(vectors: Float64) -> Float64:
    """(..., D) vectors at length 1."""
    return np.asarray(vectors / np.linalg.norm(vectors, axis=-1, keepdims=True))


FOREIGN_SIZE = 3.0  # radius of the synthetic foreign scene, in radii of the model
PLACED_SIZE = (0.15, 0.6)  # radius of the placed model, in radii of the scene it is put in; log-uniform


@ATTACKS.add(
    "put the model somewhere into a foreign scene",
    "foreign Gaussians per own one",
    3.0,
    (0.1, 0.3, 1, 3, 10, 30),
    "(0, inf)",
)
def merge_into(
    model: GaussianModel, strength: float, rng: np.random.Generator, *, other: GaussianModel | None = None
) -> GaussianModel:
    """The model, randomly placed inside a foreign scene of `strength` times as many Gaussians.

    `other` is the foreign scene, not empty, of which a connected piece is taken when it is larger than needed;
    without it a synthetic one (`foreign_scene`). Foreign Gaussians come first, then the model's in their own order,
    rotated, moved and scaled to 0.15 to 0.6 radii of the foreign scene; SH padded with zeros to the higher of the two
    degrees.
    """
    wanted = max(1, round(strength * len(model)))
    if other is not None and len(other) == 0:
        raise InputError("the foreign scene is empty")
    if other is None:
        other = foreign_scene(model, wanted, rng)
    elif wanted < len(other):
        other = crop(other, wanted / len(other), rng)
    own, host = measure_extent(model), measure_extent(other)
    factor = np.exp(rng.uniform(*np.log(PLACED_SIZE))) * host.radius / own.radius
    rotation = random_rotation(rng)
    direction = rng.standard_normal(3)
    place = host.center + host.radius * 0.7 * rng.random() * direction / np.linalg.norm(direction)
    placed = transform_model(model, float(factor), rotation, place - factor * rotation @ own.center)
    return join(other, placed)


def foreign_scene(model: GaussianModel, count: int, rng: np.random.Generator) -> GaussianModel:
    """A synthetic scene of `count` Gaussians that has nothing to do with the model but resembles it in kind.

    Textured sheets in random places of a ball of three radii of the model. Sizes, opacities and colors
    follow normal laws with the model's own mean and spread, so that no threshold on one attribute separates
    the two; no value is copied from the model.
    """
    radius = FOREIGN_SIZE * measure_extent(model).radius
    sheets = max(4, count // 1000)
    sheet = rng.integers(sheets, size=count)
    centers = rng.standard_normal((sheets, 3))
    centers *= (radius * np.cbrt(rng.random(sheets)) / np.linalg.norm(centers, axis=1))[:, None]
    half_sizes = radius * rng.uniform(0.05, 0.3, (sheets, 3)) * np.array([1.0, 1.0, 0.02])
    turns = quaternion_to_rotation(unit(rng.standard_normal((sheets, 4))))
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
        unit(rng.standard_normal((count, 4))).astype(np.float32),
        alike(model.opacity_logits, (count,)),
        sh,
    )


@ATTACKS.add(
    "write in a trade format and read back", "format", "splat", ("ply", "spz", "compressed.ply", "sog", "splat")
)
def convert(model: GaussianModel, strength: str, rng: np.random.Generator) -> GaussianModel:
    """Order, SH degree and precision are the format's choice."""
    from engine.formats import encode_model, read_model

    return read_model(encode_model(model, strength), name=f"model.{strength}").model


@ATTACKS.add(
    "bend the model to an arc, random side", "degrees from end to end", 30.0, (1, 3, 5, 10, 20, 30, 45, 60, 90)
)
def bend(model: GaussianModel, strength: float, rng: np.random.Generator) -> GaussianModel:
    side = rng.standard_normal(3)  # its part along the axis does not count
    return deformations.bend(model, strength, toward=side)


@ATTACKS.add(
    "turn the two ends of the model against each other",
    "degrees from end to end",
    30.0,
    (1, 3, 5, 10, 20, 30, 45, 60, 90, 180),
)
def twist(model: GaussianModel, strength: float, rng: np.random.Generator) -> GaussianModel:
    """In a random sense."""
    return deformations.twist(model, strength if rng.random() < 0.5 else -strength)


@ATTACKS.add(
    "press the model together along its length, its middle bulging",
    "lost share of the length",
    0.2,
    (0.01, 0.03, 0.05, 0.1, 0.2, 0.3, 0.5, 0.7),
    "[0, 1)",
)
def squash(model: GaussianModel, strength: float, rng: np.random.Generator) -> GaussianModel:
    return deformations.squash(model, strength)
