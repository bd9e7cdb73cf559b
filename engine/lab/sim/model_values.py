"""Attacks that change what Gaussians are: parameter noise, coarser values; and the severities of FlyMark's table.

All are pure functions `(model, strength, rng) -> model`; but for `inject`, count and order stay.
"""

from typing import Any

import numpy as np
import numpy.typing as npt

from engine.flows.views.camera_rig import measure_extent
from engine.lab.sim.attack import Attacks
from engine.model import SH_C0, Float32, Float64, GaussianModel

__all__ = ["ATTACKS"]


ATTACKS: Attacks[GaussianModel] = Attacks("model")

_OWN_STD = "noise std, in standard deviations of the attribute"
_SPREADS = (0.001, 0.003, 0.01, 0.03, 0.1, 0.2, 0.3, 0.5, 1.0)


@ATTACKS.add("noise on the centers", _OWN_STD, 0.01, _SPREADS, "[0, inf)")
def noise_means(model: GaussianModel, strength: float, rng: np.random.Generator) -> GaussianModel:
    """The standard deviation is pooled over the axes."""
    return model.with_(means=_noisy(model.means, strength, rng))


@ATTACKS.as_code("noise_means", "noise std, scene units", 1.0, (0.01, 0.1, 1.0), "[0, inf)")
def noise_means_wild(model: GaussianModel, strength: float, rng: np.random.Generator) -> GaussianModel:
    """GaussianMarker's position noise: N(0, `strength`^2) in scene units, whatever the scene's size."""
    return model.with_(means=model.means + np.float32(strength) * normal(model.means, rng))


@ATTACKS.add("noise on all of SH", _OWN_STD, 0.1, _SPREADS, "[0, inf)")
def noise_colors(model: GaussianModel, strength: float, rng: np.random.Generator) -> GaussianModel:
    """Each coefficient by its own standard deviation."""
    return model.with_(sh=_noisy_sh(model.sh, strength, rng))


@ATTACKS.as_code("noise_colors", "noise std on DC coefficients", 8.0, (0.1, 1.0, 8.0), "[0, inf)")
def noise_dc_wild(model: GaussianModel, strength: float, rng: np.random.Generator) -> GaussianModel:
    """GaussianMarker's color noise: N(0, `strength`^2) on the DC coefficients, the code's 8 is far beyond white."""
    return model.with_dc(model.sh[:, 0] + np.float32(strength) * normal(model.sh[:, 0], rng))


@ATTACKS.add("noise on every attribute", _OWN_STD, 0.1, _SPREADS, "[0, inf)")
def noise_all(model: GaussianModel, strength: float, rng: np.random.Generator) -> GaussianModel:
    """Quaternions stay unit."""
    return GaussianModel(
        _noisy(model.means, strength, rng),
        _noisy(model.log_scales, strength, rng),
        _unit(_noisy(model.quats, strength, rng)),
        _noisy(model.opacity_logits, strength, rng),
        _noisy_sh(model.sh, strength, rng),
    )


@ATTACKS.add("cut the spherical harmonics", "degree kept", 0, (3, 2, 1, 0), "0..3")
def drop_sh(model: GaussianModel, strength: int, rng: np.random.Generator) -> GaussianModel:
    """0 leaves the DC color alone."""
    return model.with_(sh=model.sh[:, : (strength + 1) ** 2])


@ATTACKS.add(
    "round every property between its smallest and largest value",
    "bits a property",
    8,
    (16, 12, 10, 8, 7, 6, 5, 4, 3, 2),
    "1..24",
)
def quantize(model: GaussianModel, strength: int, rng: np.random.Generator) -> GaussianModel:
    """A property is one column of a PLY file: one axis of the centers, one SH coefficient of one channel.

    Quaternions are normalized afterwards.
    """
    levels = 2**strength - 1
    return model.with_(
        means=_rounded(model.means, levels),
        log_scales=_rounded(model.log_scales, levels),
        quats=_unit(_rounded(model.quats, levels)),
        opacity_logits=_rounded(model.opacity_logits, levels),
        sh=_rounded(model.sh, levels),
    )


def normal(like: Float32, rng: np.random.Generator) -> Float32:
    """Standard normal noise of the shape of an array."""
    return rng.standard_normal(like.shape, dtype=np.float32)


def _noisy(values: Float32, factor: float, rng: np.random.Generator) -> Float32:
    """One spread for the whole attribute: noise must not depend on how the axes happen to lie."""
    spread = np.sqrt(values.astype(np.float64).var(axis=0).mean())
    return values + np.float32(factor * spread) * normal(values, rng)


def _noisy_sh(sh: Float32, factor: float, rng: np.random.Generator) -> Float32:
    spread = np.sqrt(sh.astype(np.float64).var(axis=0).mean(axis=1))[:, None]  # (K, 1): channels pooled
    noise: Float32 = np.float32(factor) * spread.astype(np.float32) * normal(sh, rng)
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


INJECTED_REACH = 0.02
"""Injected Gaussians lie this far (std, robust radii) from some Gaussian of the model: where they are seen."""

OPACITY_MARGIN = 1.0 / 255.0  # noisy opacities stay this far from 0 and 1, as an 8-bit file keeps them


@ATTACKS.add(
    "add Gaussians that look like the model's own", "added share", 0.1, (0.01, 0.05, 0.1, 0.3, 0.5, 1.0), "[0, 1]"
)
def inject(model: GaussianModel, strength: float, rng: np.random.Generator) -> GaussianModel:
    """Add `strength` Gaussians per Gaussian, appended: they lie among the model's own and look like them in kind.

    Size, rotation, opacity and color of each are those of independently drawn Gaussians of the model.
    """
    count = round(strength * len(model))
    pick = [rng.integers(len(model), size=count) for _ in range(5)]
    reach = INJECTED_REACH * measure_extent(model).radius
    places = model.means[pick[0]] + reach * rng.standard_normal((count, 3))
    return model.with_(
        means=np.concatenate([model.means, places.astype(np.float32)]),
        log_scales=np.concatenate([model.log_scales, model.log_scales[pick[1]]]),
        quats=np.concatenate([model.quats, model.quats[pick[2]]]),
        opacity_logits=np.concatenate([model.opacity_logits, model.opacity_logits[pick[3]]]),
        sh=np.concatenate([model.sh, model.sh[pick[4]]]),
    )


@ATTACKS.add("noise on the DC color alone", "noise std, range 1", 0.01, (0.005, 0.01, 0.02, 0.05, 0.1, 0.2), "[0, inf)")
def noise_dc(model: GaussianModel, strength: float, rng: np.random.Generator) -> GaussianModel:
    return model.with_dc(model.sh[:, 0] + np.float32(strength / SH_C0) * normal(model.sh[:, 0], rng))


@ATTACKS.add("noise on the opacities", "noise std, range 1", 0.1, (0.01, 0.05, 0.1, 0.2, 0.5), "[0, inf)")
def noise_opacity(model: GaussianModel, strength: float, rng: np.random.Generator) -> GaussianModel:
    """Clipped a 255th short of both ends."""
    noisy = model.opacities.astype(np.float64) + strength * rng.standard_normal(len(model))
    kept = np.clip(noisy, OPACITY_MARGIN, 1.0 - OPACITY_MARGIN)
    return model.with_(opacity_logits=(np.log(kept) - np.log1p(-kept)).astype(np.float32))


@ATTACKS.add(
    "noise on the centers, in units of the scene",
    "noise std, robust radii",
    0.005,
    (0.0005, 0.001, 0.005, 0.01, 0.03),
    "[0, inf)",
)
def noise_position(model: GaussianModel, strength: float, rng: np.random.Generator) -> GaussianModel:
    std = strength * measure_extent(model).radius
    return model.with_(means=model.means + np.float32(std) * normal(model.means, rng))


@ATTACKS.add("round the colors alone", "bits a coefficient", 6, (12, 8, 7, 6, 5, 4, 3, 2), "1..24")
def quantize_colors(model: GaussianModel, strength: int, rng: np.random.Generator) -> GaussianModel:
    """Each SH coefficient between its smallest and largest value."""
    return model.with_(sh=quantize(model, strength, rng).sh)


@ATTACKS.add(
    "write shorter floating-point numbers", "bits of mantissa, 10 is float16", 10, (10, 7, 6, 5, 4, 3, 2), "0..23"
)
def round_floats(model: GaussianModel, strength: int, rng: np.random.Generator) -> GaussianModel:
    """7 bits of mantissa are bfloat16, 3 an 8-bit float.

    Rounded to nearest even. The exponent keeps its range: values of a model lie well inside float16's, where it
    would round to multiples of 6e-8 at worst.
    """
    quats = _short(model.quats, strength)
    norm = np.linalg.norm(quats, axis=1, keepdims=True)
    return model.with_(
        means=_short(model.means, strength),
        log_scales=_short(model.log_scales, strength),
        quats=quats / np.maximum(norm, np.float32(1e-6)),
        opacity_logits=_short(model.opacity_logits, strength),
        sh=_short(model.sh, strength),
    )


def _short(values: Float32, bits: int) -> Float32:
    mantissa, exponent = np.frexp(values)  # mantissa in [1/2, 1): one bit is implicit in IEEE's
    grid = np.float32(2.0 ** (bits + 1))
    return np.ldexp(np.rint(mantissa * grid) / grid, exponent).astype(np.float32)
