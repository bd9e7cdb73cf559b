"""Attacks on the look: view dependence baked away, colors smoothed over neighbors, regions painted anew.

All are pure functions `(model, strength, rng) -> model`; geometry and opacities stay.
"""

import numpy as np

from engine.flows.views.camera_rig import make_rig, measure_extent
from engine.lab.sim.attack import Attacks
from engine.model import SH_C0, Float32, Float64, GaussianModel

ATTACKS: Attacks[GaussianModel] = Attacks("model")

BAKE_SIZE = 256  # side of the views over which colors are averaged, pixels
REGION_SHARE = 0.05  # Gaussians of one repainted region, as a share of all

_LUMA = np.array([0.299, 0.587, 0.114])


@ATTACKS.add("bake spherical harmonics to plain RGB over views", "views", 24, (96, 24, 8, 3, 1), "1..256")
def bake_colors(model: GaussianModel, strength: int, rng: np.random.Generator) -> GaussianModel:
    """Each Gaussian keeps the mean of its colors over `strength` views.

    A view counts for a Gaussian by the blending weight it has there; one seen nowhere gets the plain mean.
    """
    from engine.raster import prepare_view, sh_colors

    total, weight, plain = np.zeros((len(model), 3)), np.zeros((len(model), 1)), np.zeros((len(model), 3))
    for camera in make_rig(model, strength, BAKE_SIZE, BAKE_SIZE, jitter=rng.random((strength, 4))):
        seen = prepare_view(model, camera).weights()[0].astype(np.float64)[:, None]
        colors = sh_colors(model.sh, model.means, camera.position.astype(np.float32))
        total += seen * colors
        plain += colors / strength
        weight += seen
    mean = np.where(weight > 0, total / np.maximum(weight, 1e-30), plain)
    return model.with_(sh=((mean - 0.5) / SH_C0).astype(np.float32)[:, None])


@ATTACKS.add("mean color over similar neighbors", "neighbors", 8, (2, 4, 8, 16, 32, 64), "1..256")
def smooth_colors(model: GaussianModel, strength: int, rng: np.random.Generator) -> GaussianModel:
    """A bilateral filter of DC over the surface; the Gaussian itself is the first neighbor.

    Neighbors count by exp(-d^2 / 2 sigma^2) of their color distance, sigma the median distance to a neighbor, so
    that edges stay.
    """
    from scipy.spatial import cKDTree

    count = min(strength, len(model))
    if count == 1:
        return model
    near = cKDTree(model.means).query(model.means, k=count, workers=2)[1]  # (N, count)
    dc = model.sh[:, 0].astype(np.float64)
    sample = dc[near[:: max(1, len(dc) // 4096)]]
    sigma2 = max(float(np.median(np.square(sample[:, 1:] - sample[:, :1]).sum(axis=2))), 1e-12)
    total, weight = np.zeros_like(dc), np.zeros((len(dc), 1))
    for column in near.T:
        other = dc[column]
        alike = np.exp(-0.5 * np.square(other - dc).sum(axis=1, keepdims=True) / sigma2)
        total += alike * other
        weight += alike
    return model.with_dc(total / weight)


@ATTACKS.add(
    "paint regions anew, as editing by a diffusion model would",
    "repainted share",
    0.5,
    (0.1, 0.25, 0.5, 0.75, 0.9, 1.0),
    "[0, 1]",
)
def repaint(model: GaussianModel, strength: float, rng: np.random.Generator) -> GaussianModel:
    """A share `strength` of the model, region by region: a stand-in for editing by a diffusion model.

    Connected regions of a twentieth of the Gaussians keep their light and shade and get another color, another
    contrast and a smooth pattern of their own; view dependence goes there. A real diffusion edit needs a network that
    is not part of this program: this one is at least as strong in color and leaves geometry alone.
    """
    means = model.means.astype(np.float64)
    radius = measure_extent(model).radius
    wanted = round(strength * len(model))
    colors = 0.5 + SH_C0 * model.sh[:, 0].astype(np.float64)
    painted = np.zeros(len(model), dtype=bool)
    sh = model.sh.copy()
    while wanted > 0:
        left = np.flatnonzero(~painted)
        seed = means[left[rng.integers(len(left))]]
        size = min(wanted, max(1, round(REGION_SHARE * len(model))))
        distance = np.square(means[left] - seed).sum(axis=1)
        region = left[np.argsort(distance, kind="stable")[:size]]
        sh[region, 0] = (_palette(colors[region], (means[region] - seed) / radius, rng) - 0.5) / SH_C0
        sh[region, 1:] = 0.0
        painted[region] = True
        wanted -= size
    return model.with_(sh=sh)


def _palette(colors: Float64, place: Float64, rng: np.random.Generator) -> Float32:
    """New colors (n, 3) of a region, from its own light and shade; place (n, 3) in radii of the scene."""
    light = np.clip(colors @ _LUMA, 0.0, 1.0)[:, None]
    tint = rng.uniform(0.2, 1.0, 3)
    tint /= tint @ _LUMA
    pattern = np.sin(place @ rng.normal(0.0, 12.0, (3, 3)) + rng.uniform(0.0, 2.0 * np.pi, 3))
    gamma = np.exp(rng.uniform(-0.4, 0.4))
    painted: Float32 = np.clip(light**gamma * tint + 0.08 * pattern, 0.0, 1.0).astype(np.float32)
    return painted
