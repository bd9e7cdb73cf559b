"""Model attacks with the severities and readings of other systems' papers and public code.

FlyMark's table: injected Gaussians, noise on DC, opacities and positions in absolute units, coarser colours, short
floats. GaussianMarker's code: "rotate" by any matrix, "translate" each point by itself, noise in scene units, and a
"crop" that drops one block of the file; apart from the last they hardly leave a scene.

All are pure functions `(model, strength, rng) -> model`.
"""

import numpy as np

from engine.errors import InputError
from engine.model import SH_C0, Float32, GaussianModel
from engine.sim.attack import check_fraction, check_positive

__all__ = [
    "drop_block",
    "inject",
    "mix_axes",
    "noise_dc",
    "noise_dc_wild",
    "noise_opacity",
    "noise_position",
    "noise_position_wild",
    "quantize_colors",
    "round_floats",
    "scatter",
]

INJECTED_REACH = 0.02
"""Injected Gaussians lie this far (std, robust radii) from some Gaussian of the model: where they are seen."""

OPACITY_MARGIN = 1.0 / 255.0
"""Noisy opacities stay this far from 0 and 1, as an 8-bit file keeps them."""


def inject(model: GaussianModel, strength: float, rng: np.random.Generator) -> GaussianModel:
    """Add `strength` Gaussians per Gaussian, appended: they lie among the model's own and look like them in kind.

    Size, rotation, opacity and colour of each are those of independently drawn Gaussians of the model.
    """
    from engine.pipeline.rigs import measure_extent

    count = round(check_fraction(strength, "injected share", one=True) * len(model))
    pick = [rng.integers(len(model), size=count) for _ in range(5)]
    reach = INJECTED_REACH * measure_extent(model).radius
    places = model.means[pick[0]] + reach * rng.standard_normal((count, 3))
    return GaussianModel(
        np.concatenate([model.means, places.astype(np.float32)]),
        np.concatenate([model.log_scales, model.log_scales[pick[1]]]),
        np.concatenate([model.quats, model.quats[pick[2]]]),
        np.concatenate([model.opacity_logits, model.opacity_logits[pick[3]]]),
        np.concatenate([model.sh, model.sh[pick[4]]]),
    )


def noise_dc(model: GaussianModel, strength: float, rng: np.random.Generator) -> GaussianModel:
    """Gaussian noise of std `strength` on the DC colour, range 0..1; the higher coefficients stay."""
    std = check_positive(strength, "noise std", zero=True) / SH_C0
    return model.with_dc(model.sh[:, 0] + np.float32(std) * _normal(model.sh[:, 0].shape, rng))


def noise_dc_wild(model: GaussianModel, strength: float, rng: np.random.Generator) -> GaussianModel:
    """GaussianMarker's colour noise: N(0, `strength`^2) on the DC coefficients, the code's 8 is far beyond white."""
    return noise_dc(model, check_positive(strength, "noise std", zero=True) * SH_C0, rng)


def noise_opacity(model: GaussianModel, strength: float, rng: np.random.Generator) -> GaussianModel:
    """Gaussian noise of std `strength` on the opacities, range 0..1, clipped a 255th short of both ends."""
    std = check_positive(strength, "noise std", zero=True)
    noisy = model.opacities.astype(np.float64) + std * rng.standard_normal(len(model))
    kept = np.clip(noisy, OPACITY_MARGIN, 1.0 - OPACITY_MARGIN)
    return model.with_(opacity_logits=(np.log(kept) - np.log1p(-kept)).astype(np.float32))


def noise_position(model: GaussianModel, strength: float, rng: np.random.Generator) -> GaussianModel:
    """Gaussian noise on the centres, std `strength` robust radii of the scene."""
    from engine.pipeline.rigs import measure_extent

    std = check_positive(strength, "noise std", zero=True) * measure_extent(model).radius
    return model.with_(means=model.means + np.float32(std) * _normal(model.means.shape, rng))


def noise_position_wild(model: GaussianModel, strength: float, rng: np.random.Generator) -> GaussianModel:
    """GaussianMarker's position noise: N(0, `strength`^2) in scene units, whatever the scene's size."""
    std = check_positive(strength, "noise std", zero=True)
    return model.with_(means=model.means + np.float32(std) * _normal(model.means.shape, rng))


def mix_axes(model: GaussianModel, strength: float, rng: np.random.Generator) -> GaussianModel:
    """GaussianMarker's "rotate": centres times a random normal 3x3 matrix, at 1; below, a blend with the identity.

    Neither orthogonal nor applied to rotations or colours: as the code runs it.
    """
    share = check_fraction(strength, "share of the random matrix", one=True)
    matrix = (1.0 - share) * np.eye(3) + share * rng.standard_normal((3, 3))
    return model.with_(means=(model.means.astype(np.float64) @ matrix).astype(np.float32))


def scatter(model: GaussianModel, strength: float, rng: np.random.Generator) -> GaussianModel:
    """GaussianMarker's "translate": every point by a shift of its own, N(0, `strength`^2) scene units."""
    return noise_position_wild(model, strength, rng)


def drop_block(model: GaussianModel, strength: float, rng: np.random.Generator) -> GaussianModel:
    """GaussianMarker's "crop": drop one contiguous block of the file's order, `strength` of its Gaussians."""
    share = check_fraction(strength, "dropped share")
    count = min(round(share * len(model)), len(model) - 1)
    start = int(rng.integers(len(model) - count + 1))
    keep = np.ones(len(model), dtype=bool)
    keep[start : start + count] = False
    return model.take(keep)


def quantize_colors(model: GaussianModel, strength: float, rng: np.random.Generator) -> GaussianModel:
    """Round the colours alone to `strength` bits: each SH coefficient between its smallest and largest value."""
    if strength not in range(1, 25):
        raise InputError(f"bits must be a whole number from 1 to 24, got {strength}")
    from engine.sim.model_values import quantize

    return model.with_(sh=quantize(model, strength, rng).sh)


def round_floats(model: GaussianModel, strength: float, rng: np.random.Generator) -> GaussianModel:
    """Every value with `strength` bits of mantissa: 10 is float16, 7 bfloat16, 3 an 8-bit float.

    Rounded to nearest even. The exponent keeps its range: values of a model lie well inside float16's, where it
    would round to multiples of 6e-8 at worst.
    """
    if strength not in range(0, 24):
        raise InputError(f"mantissa bits must be a whole number from 0 to 23, got {strength}")
    bits = int(strength)
    quats = _short(model.quats, bits)
    norm = np.linalg.norm(quats, axis=1, keepdims=True)
    return GaussianModel(
        _short(model.means, bits),
        _short(model.log_scales, bits),
        quats / np.maximum(norm, np.float32(1e-6)),
        _short(model.opacity_logits, bits),
        _short(model.sh, bits),
    )


def _short(values: Float32, bits: int) -> Float32:
    mantissa, exponent = np.frexp(values)  # mantissa in [1/2, 1): one bit is implicit in IEEE's
    grid = np.float32(2.0 ** (bits + 1))
    return np.ldexp(np.rint(mantissa * grid) / grid, exponent).astype(np.float32)


def _normal(shape: tuple[int, ...], rng: np.random.Generator) -> Float32:
    return rng.standard_normal(shape, dtype=np.float32)
