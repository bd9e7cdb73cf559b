"""What each Gaussian contributes to the views: impact (Eq 4), W^freq, and Laplace uncertainty (DESIGN 4.2, 4.3).

Summed over pixels, alpha_i T_i times a pixel map is the rasterizer's VJP with respect to a scalar colour with that
map as cotangent, so Eq 4 costs one backward pass a view.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import scipy

from engine.compress.config import CONFIG
from engine.model import Bool, Camera, Float32, Float64, GaussianModel
from engine.numerics.spherical_harmonics import sh_basis
from engine.numerics.wavelet import coefficient_detail, high_frequency_energy
from engine.raster import View


@dataclass(frozen=True, eq=False)
class Impact:
    """Contributions summed over the views."""

    coverage: Float64  # (N,) sum over views and pixels of w = alpha T: pixels covered
    per_view: Float32  # (V, N) the same, view by view
    busy: Float64  # (N,) sum of w times the high-frequency DWT energy of the pixel (first two factors of Eq 4)
    squared: Float64  # (N,) sum over views and pixels of w^2


def measure_impact(model: GaussianModel, views: Sequence[View], images: Sequence[Float32]) -> Impact:
    """What every Gaussian contributes to some prepared views of the model, and renders (H, W, 3) of them."""
    n = len(model)
    per_view = np.zeros((len(views), n), dtype=np.float32)
    busy, squared = np.zeros(n), np.zeros(n)
    for v, (view, image) in enumerate(zip(views, images, strict=True)):
        energy = np.sqrt(high_frequency_energy(np.clip(image, 0.0, 1.0))).astype(np.float32)
        busy += view.backward_colors(energy[:, :, None])[:, 0]
        sum_w, sum_w2 = view.weights()
        per_view[v], squared = sum_w, squared + sum_w2
    coverage = per_view.sum(axis=0, dtype=np.float64)
    return Impact(coverage, per_view, busy, squared)


def paper_impact(model: GaussianModel, impact: Impact) -> Float64:
    """(N,) Eq 4 as printed: what a Gaussian adds to busy pixels, times its spatial coherence."""
    return impact.busy * spatial_coherence(model)


def frequency_impact(model: GaussianModel, impact: Impact) -> Float64:
    """(N,) W^freq = W* ||DWT(g)||_2 of the paper: Eq 4 times the detail of the Gaussian's own colour.

    A model of DC alone has no detail over its coefficients; its factor is 1, and W^freq is Eq 4, where the image's
    detail stands already.
    """
    whole = paper_impact(model, impact)
    if model.sh_degree == 0:
        return whole
    detail = coefficient_detail(model.sh.astype(np.float64)).reshape(len(model), -1)
    return np.asarray(whole * np.linalg.norm(detail, axis=1))


def ranks(values: Float64) -> Float64:
    """(N,) rank of each value in (0, 1], the largest 1."""
    rank = np.empty(len(values))
    rank[np.argsort(values, kind="stable")] = np.arange(1, len(values) + 1) / len(values)
    return rank


def spatial_coherence(model: GaussianModel) -> Float64:
    """(N,) exp(-|mu_i - mu_nn|^2 / 2 sigma^2), third factor of Eq 4; sigma is twice the median distance."""
    if len(model) < 2:
        return np.ones(len(model))
    distance = scipy.spatial.cKDTree(model.means).query(model.means, k=2, workers=2)[0][:, 1]
    sigma = 2.0 * float(np.median(distance)) + 1e-30
    return np.asarray(np.exp(-0.5 * np.minimum(distance / sigma, 10.0) ** 2))


def seen_harmonics(model: GaussianModel, camera: Camera, degree: int) -> Float32:
    """(N, K) basis functions up to a degree at the directions in which a camera sees each Gaussian."""
    direction = model.means - camera.position.astype(np.float32)
    direction /= np.maximum(np.linalg.norm(direction, axis=1, keepdims=True), 1e-12)
    return np.asarray(sh_basis(direction, degree))


def sh_curvature(model: GaussianModel, views: Sequence[View], cameras: Sequence[Camera]) -> Float32:
    """(N, K) diagonal Gauss-Newton curvature H_i,lm = sum over views and pixels of w_i(p)^2 Y_lm(d_i)^2."""
    curvature = np.zeros((len(model), model.sh.shape[1]), dtype=np.float32)
    for view, camera in zip(views, cameras, strict=True):
        basis = seen_harmonics(model, camera, model.sh_degree)
        curvature += (view.weights()[1][:, None] * basis**2).astype(np.float32)
    return curvature


def uncertainty(curvature: Float32 | Float64, prior: float = CONFIG.prior) -> Float64:
    """U = 1 / (H + prior), the Laplace posterior variance (DESIGN 4.3)."""
    return np.asarray(1.0 / (curvature.astype(np.float64) + prior))


def uncertain(curvature: Float32 | Float64, deviations: float) -> Bool:
    """(N, K) which coefficients lie above the paper's threshold tau_unc = mean(U) + s std(U), s the `deviations`."""
    doubt = uncertainty(curvature)
    return np.asarray(doubt > doubt.mean() + deviations * doubt.std())
