"""Attacks that change what Gaussians are: parameter noise, coarser values, other file formats.

All are pure functions `(model, strength, rng) -> model`; the count and order stay (but for `convert`, where
the format decides).
"""

from typing import Any

import numpy as np
import numpy.typing as npt

from engine.errors import InputError
from engine.model import Float32, Float64, GaussianModel
from engine.sim.attack import check_positive

__all__ = ["convert", "drop_sh", "noise_all", "noise_colors", "noise_means", "quantize"]


def noise_means(model: GaussianModel, strength: float, rng: np.random.Generator) -> GaussianModel:
    """Gaussian noise on the centres, `strength` times their standard deviation (pooled over the axes)."""
    return model.with_(means=_noisy(model.means, _strength(strength), rng))


def noise_colors(model: GaussianModel, strength: float, rng: np.random.Generator) -> GaussianModel:
    """Gaussian noise on every SH coefficient, `strength` times the coefficient's own standard deviation."""
    return model.with_(sh=_noisy_sh(model.sh, _strength(strength), rng))


def noise_all(model: GaussianModel, strength: float, rng: np.random.Generator) -> GaussianModel:
    """Gaussian noise on every attribute, `strength` times its standard deviation; quaternions stay unit."""
    factor = _strength(strength)
    return GaussianModel(
        _noisy(model.means, factor, rng),
        _noisy(model.log_scales, factor, rng),
        _unit(_noisy(model.quats, factor, rng)),
        _noisy(model.opacity_logits, factor, rng),
        _noisy_sh(model.sh, factor, rng),
    )


def drop_sh(model: GaussianModel, strength: float, rng: np.random.Generator) -> GaussianModel:
    """Cut the spherical harmonics down to degree `strength`; 0 leaves the DC colour alone."""
    if strength not in (0, 1, 2, 3):
        raise InputError(f"SH degree must be 0, 1, 2 or 3, got {strength}")
    return model.with_(sh=model.sh[:, : (int(strength) + 1) ** 2])


def quantize(model: GaussianModel, strength: float, rng: np.random.Generator) -> GaussianModel:
    """Round every property to `strength` bits, uniformly between its own smallest and largest value.

    A property is one column of a PLY file: one axis of the centres, one SH coefficient of one channel.
    Quaternions are normalised afterwards.
    """
    if strength not in range(1, 25):
        raise InputError(f"bits must be a whole number from 1 to 24, got {strength}")
    levels = 2 ** int(strength) - 1
    return GaussianModel(
        _rounded(model.means, levels),
        _rounded(model.log_scales, levels),
        _unit(_rounded(model.quats, levels)),
        _rounded(model.opacity_logits, levels),
        _rounded(model.sh, levels),
    )


def convert(model: GaussianModel, strength: str, rng: np.random.Generator) -> GaussianModel:
    """Write the model in the trade format `strength` and read it back.

    Parameters
    ----------
    strength : str
        A format that `engine.formats.encode_model` writes: "ply", "compressed.ply", "splat", "spz", "sog".
    rng : numpy.random.Generator
        Not used: writers are deterministic.

    Returns
    -------
    GaussianModel
        As the format left it: order, SH degree and precision are the format's choice.

    Raises
    ------
    InputError
        If the format is not written here.
    """
    from engine.formats import encode_model, read_model

    return read_model(encode_model(model, strength), name=f"model.{strength}").model


def _strength(value: float) -> float:
    return check_positive(value, "noise in standard deviations", zero=True)


def _noisy(values: Float32, factor: float, rng: np.random.Generator) -> Float32:
    """One spread for the whole attribute: noise must not depend on how the axes happen to lie."""
    spread = np.sqrt(values.astype(np.float64).var(axis=0).mean())
    return values + np.float32(factor * spread) * rng.standard_normal(values.shape, dtype=np.float32)


def _noisy_sh(sh: Float32, factor: float, rng: np.random.Generator) -> Float32:
    spread = np.sqrt(sh.astype(np.float64).var(axis=0).mean(axis=1))[:, None]  # (K, 1): channels pooled
    noise: Float32 = np.float32(factor) * spread.astype(np.float32) * rng.standard_normal(sh.shape, np.float32)
    return sh + noise


def _rounded(values: Float32, levels: int) -> Float32:
    low = values.min(axis=0).astype(np.float64)
    step = (values.max(axis=0).astype(np.float64) - low) / levels
    step = np.where(step > 0, step, 1.0)  # a constant property stays as it is
    rounded: Float64 = low + step * np.round((values - low) / step)
    return rounded.astype(np.float32)


def _unit(quats: npt.NDArray[Any]) -> Float32:
    """Unit quaternions; the identity where nothing is left of one."""
    norm: Float64 = np.linalg.norm(quats.astype(np.float64), axis=1, keepdims=True)
    identity = np.array([1.0, 0.0, 0.0, 0.0])
    return np.where(norm > 1e-12, quats / np.maximum(norm, 1e-12), identity).astype(np.float32)
