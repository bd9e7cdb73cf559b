"""Model attacks with the severities of FlyMark's table.

Injected Gaussians, noise on DC, opacities and positions in absolute units, coarser colours, short floats. All are pure
functions `(model, strength, rng) -> model`.
"""

import numpy as np

from engine.flows.views.camera_rig import measure_extent
from engine.lab.sim.attack import Attacks
from engine.lab.sim.model_values import normal, quantize
from engine.model import SH_C0, Float32, GaussianModel

__all__ = ["ATTACKS"]

ATTACKS: Attacks[GaussianModel] = Attacks("model")

INJECTED_REACH = 0.02
"""Injected Gaussians lie this far (std, robust radii) from some Gaussian of the model: where they are seen."""

OPACITY_MARGIN = 1.0 / 255.0
"""Noisy opacities stay this far from 0 and 1, as an 8-bit file keeps them."""


@ATTACKS.add(
    "add Gaussians that look like the model's own", "added share", 0.1, (0.01, 0.05, 0.1, 0.3, 0.5, 1.0), "[0, 1]"
)
def inject(model: GaussianModel, strength: float, rng: np.random.Generator) -> GaussianModel:
    """Add `strength` Gaussians per Gaussian, appended: they lie among the model's own and look like them in kind.

    Size, rotation, opacity and colour of each are those of independently drawn Gaussians of the model.
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


@ATTACKS.add(
    "noise on the DC colour alone", "noise std, range 1", 0.01, (0.005, 0.01, 0.02, 0.05, 0.1, 0.2), "[0, inf)"
)
def noise_dc(model: GaussianModel, strength: float, rng: np.random.Generator) -> GaussianModel:
    return model.with_dc(model.sh[:, 0] + np.float32(strength / SH_C0) * normal(model.sh[:, 0], rng))


@ATTACKS.add("noise on the opacities", "noise std, range 1", 0.1, (0.01, 0.05, 0.1, 0.2, 0.5), "[0, inf)")
def noise_opacity(model: GaussianModel, strength: float, rng: np.random.Generator) -> GaussianModel:
    """Clipped a 255th short of both ends."""
    noisy = model.opacities.astype(np.float64) + strength * rng.standard_normal(len(model))
    kept = np.clip(noisy, OPACITY_MARGIN, 1.0 - OPACITY_MARGIN)
    return model.with_(opacity_logits=(np.log(kept) - np.log1p(-kept)).astype(np.float32))


@ATTACKS.add(
    "noise on the centres, in units of the scene",
    "noise std, robust radii",
    0.005,
    (0.0005, 0.001, 0.005, 0.01, 0.03),
    "[0, inf)",
)
def noise_position(model: GaussianModel, strength: float, rng: np.random.Generator) -> GaussianModel:
    std = strength * measure_extent(model).radius
    return model.with_(means=model.means + np.float32(std) * normal(model.means, rng))


@ATTACKS.add("round the colours alone", "bits a coefficient", 6, (12, 8, 7, 6, 5, 4, 3, 2), "1..24")
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
