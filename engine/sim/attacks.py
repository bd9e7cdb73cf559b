"""The attacks by name, with their strengths as data. Where papers and code differ, both readings stand.

Sources of the readings: the public code of GuardSplat, 3D-GSW, WateRF and GaussianMarker. One thing of theirs
is left out: 3D-GSW and WateRF cast noisy images back to 8 bit without clipping, so that white wraps to black.
"""

from collections.abc import Iterable
from typing import Any

from engine.errors import InputError
from engine.model import Float32, GaussianModel
from engine.sim import image_attacks as on_image
from engine.sim import model_deformation as deformation
from engine.sim import model_placement as placement
from engine.sim import model_population as population
from engine.sim import model_values as values
from engine.sim.adversaries import published
from engine.sim.adversaries.attacks import ADVERSARIES, DENOISERS
from engine.sim.attack import Attack, Reading, Strength
from engine.sim.views.attacks import VIEW_ATTACKS

__all__ = ["IMAGE_ATTACKS", "MODEL_ATTACKS", "find_attack", "image_attack", "model_attack"]

_SHARES: tuple[Strength, ...] = (0.05, 0.1, 0.2, 0.3, 0.5, 0.7, 0.8, 0.9, 0.95)
_SPREADS: tuple[Strength, ...] = (0.001, 0.003, 0.01, 0.03, 0.1, 0.2, 0.3, 0.5, 1.0)
_OWN_STD = "noise std, in standard deviations of the attribute"


def _model(name: str, summary: str, *readings: Reading[GaussianModel]) -> Attack[GaussianModel]:
    return Attack(name, "model", summary, readings)


def _image(name: str, summary: str, *readings: Reading[Float32]) -> Attack[Float32]:
    return Attack(name, "image", summary, readings)


_MODEL_ATTACKS = (
    _model(
        "rotate",
        "turn the whole model about its centre, random axis",
        Reading(placement.rotate, "degrees", 30.0, (1, 5, 15, 30, 60, 90, 120, 150, 180)),
        Reading(published.mix_axes, "share of a random matrix", 1.0, (0.01, 0.1, 0.3, 1.0), "as_code"),
    ),
    _model(
        "scale",
        "scale the whole model about its centre",
        Reading(placement.scale, "factor", 0.75, (0.99, 1.1, 0.9, 0.75, 1.5, 0.5, 2.0, 0.25, 4.0, 0.1, 10.0)),
    ),
    _model(
        "translate",
        "shift the whole model in a random direction",
        Reading(placement.translate, "robust radii of the model", 1.0, (0.01, 0.1, 0.5, 1, 3, 10, 100)),
        Reading(published.scatter, "std of each point's shift, scene units", 1.0, (0.01, 0.1, 1.0), "as_code"),
    ),
    _model(
        "similarity",
        "random rotation, scale and shift together",
        Reading(placement.similarity, "largest scale factor, up or down", 2.0, (1, 1.1, 1.5, 2, 4, 10)),
    ),
    _model(
        "shuffle",
        "write the Gaussians in another order",
        Reading(placement.shuffle, "share of Gaussians moved", 1.0, (0.01, 0.1, 0.5, 1.0)),
    ),
    _model(
        "crop",
        "keep a connected piece about a random Gaussian",
        Reading(population.crop, "kept share", 0.1, (0.9, 0.7, 0.5, 0.3, 0.2, 0.1, 0.05, 0.02, 0.01)),
        Reading(published.drop_block, "dropped share of the file's order", 0.1, (0.1, 0.3, 0.5, 0.9), "as_code"),
    ),
    _model(
        "prune_random",
        "remove Gaussians at random",
        Reading(population.prune_random, "removed share", 0.2, (*_SHARES, 0.98, 0.99)),
    ),
    _model(
        "prune_opacity",
        "remove the most transparent Gaussians",
        Reading(population.prune_opacity, "removed share", 0.2, _SHARES),
    ),
    _model(
        "prune_low_impact",
        "remove the Gaussians that weigh least in rendered views",
        Reading(population.prune_low_impact, "removed share", 0.2, _SHARES),
    ),
    _model(
        "clone",
        "duplicate Gaussians",
        Reading(population.clone, "share split into look-alike pairs", 0.5, (*_SHARES[:6], 1.0)),
        Reading(population.clone_plain, "share duplicated as it is", 0.5, (*_SHARES[:6], 1.0), "as_code"),
    ),
    _model(
        "noise_means",
        "noise on the centres",
        Reading(values.noise_means, _OWN_STD, 0.01, _SPREADS),
        Reading(published.noise_position_wild, "noise std, scene units", 1.0, (0.01, 0.1, 1.0), "as_code"),
    ),
    _model(
        "noise_colors",
        "noise on all of SH",
        Reading(values.noise_colors, _OWN_STD, 0.1, _SPREADS),
        Reading(published.noise_dc_wild, "noise std on DC coefficients", 8.0, (0.1, 1.0, 8.0), "as_code"),
    ),
    _model("noise_all", "noise on every attribute", Reading(values.noise_all, _OWN_STD, 0.1, _SPREADS)),
    _model("drop_sh", "cut the spherical harmonics", Reading(values.drop_sh, "degree kept", 0, (3, 2, 1, 0))),
    _model(
        "quantize",
        "round every property between its smallest and largest value",
        Reading(values.quantize, "bits a property", 8, (16, 12, 10, 8, 7, 6, 5, 4, 3, 2)),
    ),
    _model(
        "merge_into",
        "put the model somewhere into a foreign scene",
        Reading(placement.merge_into, "foreign Gaussians per own one", 3.0, (0.1, 0.3, 1, 3, 10, 30)),
    ),
    _model(
        "convert",
        "write in a trade format and read back",
        Reading(values.convert, "format", "splat", ("ply", "spz", "compressed.ply", "sog", "splat")),
    ),
    _model(
        "bend",
        "bend the model to an arc, random side",
        Reading(deformation.bend, "degrees from end to end", 30.0, (1, 3, 5, 10, 20, 30, 45, 60, 90)),
    ),
    _model(
        "twist",
        "turn the two ends of the model against each other",
        Reading(deformation.twist, "degrees from end to end", 30.0, (1, 3, 5, 10, 20, 30, 45, 60, 90, 180)),
    ),
    _model(
        "squash",
        "press the model together along its length, its middle bulging",
        Reading(deformation.squash, "lost share of the length", 0.2, (0.01, 0.03, 0.05, 0.1, 0.2, 0.3, 0.5, 0.7)),
    ),
    *ADVERSARIES,
)

_IMAGE_ATTACKS = (
    _image(
        "jpeg", "JPEG with 4:2:0 chroma", Reading(on_image.jpeg, "quality", 10, (95, 90, 75, 50, 40, 30, 20, 10, 5, 1))
    ),
    _image(
        "noise_image",
        "white Gaussian noise, clipped",
        Reading(on_image.noise_image, "std, range 1", 0.1, (0.005, 0.01, 0.02, 0.05, 0.1, 0.2, 0.316, 0.5)),
        # "0.1" is squared before it scales the noise in GuardSplat and 3D-GSW.
        Reading(on_image.noise_image, "std, range 1", 0.01, (0.0025, 0.005, 0.01, 0.02), "as_code"),
    ),
    _image(
        "blur",
        "Gaussian blur",
        Reading(on_image.blur, "sigma, pixels", 1.0, (0.1, 0.3, 0.5, 0.8, 1, 1.5, 2, 3, 5, 8)),
        Reading(on_image.blur_small_kernel, "sigma, 3x3 pixels", 0.8, (0.1, 0.5, 0.8, 1.5), "as_code"),
    ),
    _image(
        "rotate_image",
        "rotate the picture on its canvas, black corners",
        Reading(on_image.rotate_image, "degrees", 30.0, (0.1, 0.5, 1, 3, 10, 20, 30, 45, 90, 180)),
        Reading(on_image.rotate_image_random, "largest angle, degrees", 30.0, (1, 10, 30, 90), "as_code"),
    ),
    _image(
        "scale_image",
        "resize, not scaled back",
        Reading(on_image.scale_image, "factor on each side", 0.75, (1.5, 0.95, 0.9, 0.75, 0.5, 0.25, 0.125)),
        Reading(on_image.scale_image_area, "factor on the area", 0.75, (0.9, 0.75, 0.5, 0.25), "as_code"),
    ),
    _image(
        "crop_image",
        "cut a piece out",
        Reading(on_image.crop_image, "removed area", 0.4, (0.05, 0.1, 0.2, 0.4, 0.6, 0.8, 0.9, 0.96)),
        Reading(on_image.crop_center, "kept side, centred", 0.4, (0.9, 0.707, 0.4, 0.316, 0.2), "as_code"),
    ),
    _image(
        "brightness",
        "multiply and clip",
        Reading(on_image.brightness, "factor", 1.5, (0.95, 1.05, 0.9, 1.1, 0.75, 1.25, 0.5, 1.5, 2.0, 4.0)),
    ),
    *VIEW_ATTACKS,
    *DENOISERS,
)

MODEL_ATTACKS: dict[str, Attack[GaussianModel]] = {attack.name: attack for attack in _MODEL_ATTACKS}
"""Attacks on models, by name."""

IMAGE_ATTACKS: dict[str, Attack[Float32]] = {attack.name: attack for attack in _IMAGE_ATTACKS}
"""Attacks on images, by name."""


def model_attack(name: str) -> Attack[GaussianModel]:
    """The attack on models of that name; InputError with the known names when there is none."""
    if name not in MODEL_ATTACKS:
        raise _unknown(name, MODEL_ATTACKS)
    return MODEL_ATTACKS[name]


def image_attack(name: str) -> Attack[Float32]:
    """The attack on images of that name; InputError with the known names when there is none."""
    if name not in IMAGE_ATTACKS:
        raise _unknown(name, IMAGE_ATTACKS)
    return IMAGE_ATTACKS[name]


def find_attack(name: str) -> Attack[Any]:
    """The attack of that name, of either kind; InputError with the known names when there is none."""
    if name in MODEL_ATTACKS:
        return MODEL_ATTACKS[name]
    if name in IMAGE_ATTACKS:
        return IMAGE_ATTACKS[name]
    raise _unknown(name, (*MODEL_ATTACKS, *IMAGE_ATTACKS))


def _unknown(name: str, known: Iterable[str]) -> InputError:
    return InputError(f"no attack is called {name!r}; there are {', '.join(known)}")
