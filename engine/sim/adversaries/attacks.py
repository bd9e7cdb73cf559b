"""Adversaries' attacks by name, with their strengths as data; the module of each function names its source."""

from engine.model import Float32, GaussianModel
from engine.sim.adversaries import (
    appearance,
    collusion,
    denoising,
    evolution,
    overwriting,
    published,
    purification,
    transplant,
)
from engine.sim.attack import Attack, Reading

__all__ = ["ADVERSARIES", "DENOISERS"]


def _model(name: str, summary: str, reading: Reading[GaussianModel]) -> Attack[GaussianModel]:
    return Attack(name, "model", summary, (reading,))


def _image(name: str, summary: str, reading: Reading[Float32]) -> Attack[Float32]:
    return Attack(name, "image", summary, (reading,))


ADVERSARIES: tuple[Attack[GaussianModel], ...] = (
    _model(
        "inject",
        "add Gaussians that look like the model's own",
        Reading(published.inject, "added share", 0.1, (0.01, 0.05, 0.1, 0.3, 0.5, 1.0)),
    ),
    _model(
        "noise_dc",
        "noise on the DC colour alone",
        Reading(published.noise_dc, "noise std, range 1", 0.01, (0.005, 0.01, 0.02, 0.05, 0.1, 0.2)),
    ),
    _model(
        "noise_opacity",
        "noise on the opacities",
        Reading(published.noise_opacity, "noise std, range 1", 0.1, (0.01, 0.05, 0.1, 0.2, 0.5)),
    ),
    _model(
        "noise_position",
        "noise on the centres, in units of the scene",
        Reading(published.noise_position, "noise std, robust radii", 0.005, (0.0005, 0.001, 0.005, 0.01, 0.03)),
    ),
    _model(
        "quantize_colors",
        "round the colours alone",
        Reading(published.quantize_colors, "bits a coefficient", 6, (12, 8, 7, 6, 5, 4, 3, 2)),
    ),
    _model(
        "round_floats",
        "write shorter floating-point numbers",
        Reading(published.round_floats, "bits of mantissa, 10 is float16", 10, (10, 7, 6, 5, 4, 3, 2)),
    ),
    _model(
        "bake_colors",
        "bake spherical harmonics to plain RGB over views",
        Reading(appearance.bake_colors, "views", 24, (96, 24, 8, 3, 1)),
    ),
    _model(
        "smooth_colors",
        "mean colour over similar neighbours",
        Reading(appearance.smooth_colors, "neighbours", 8, (2, 4, 8, 16, 32, 64)),
    ),
    _model(
        "repaint",
        "paint regions anew, as editing by a diffusion model would",
        Reading(appearance.repaint, "repainted share", 0.5, (0.1, 0.25, 0.5, 0.75, 0.9, 1.0)),
    ),
    _model(
        "purify",
        "remove clusters of Gaussians that contribute little to views",
        Reading(purification.purify, "least contribution, means of all", 0.25, (0.01, 0.03, 0.1, 0.25, 0.5, 1.0)),
    ),
    _model(
        "evolve",
        "prune and shift colours as a genetic search finds best",
        Reading(evolution.evolve, "least PSNR, dB", 30.0, (45, 40, 35, 30, 25, 20)),
    ),
    _model(
        "overwrite",
        "mark once more with this program and another key",
        Reading(overwriting.overwrite, "PSNR of the second mark, dB", 47.0, (50, 47, 45, 40, 35, 30, 25)),
    ),
    _model(
        "collude",
        "put several copies of one asset together",
        Reading(collusion.collude, "rule", "mean", collusion.RULES),
    ),
    _model(
        "transplant",
        "lift the mark of another model onto this one",
        Reading(transplant.transplant, "factor on the lifted mark", 1.0, (0.5, 1, 2, 4)),
    ),
)
"""On models. `collude` needs `others`, `transplant` needs `source`."""

DENOISERS: tuple[Attack[Float32], ...] = (
    _image("median", "median filter", Reading(denoising.median, "side, pixels", 3, (3, 5, 7, 9, 15))),
    _image(
        "bilateral",
        "bilateral filter",
        Reading(denoising.bilateral, "colour std, range 1", 0.1, (0.02, 0.05, 0.1, 0.2, 0.4)),
    ),
    _image(
        "denoise_nonlocal",
        "non-local means",
        Reading(denoising.denoise_nonlocal, "filter strength, grey levels", 5, (2, 3, 5, 10, 20)),
    ),
    _image(
        "denoise_wavelet",
        "shrink the details of a wavelet transform",
        Reading(denoising.denoise_wavelet, "threshold, range 1", 0.03, (0.005, 0.01, 0.03, 0.1, 0.2)),
    ),
)
"""On images."""
