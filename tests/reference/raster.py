"""The image, defined the slow way: every Gaussian over every pixel, in float64, nearest first.

Works on torch tensors, so that autograd of the definition is the definition of every gradient.
"""

from __future__ import annotations

import numpy as np
import torch

from engine.model import Camera, GaussianModel
from engine.numerics.spherical_harmonics import sh_basis
from engine.raster.settings import FRUSTUM_MARGIN, MAX_SIGMA_PX, RasterSettings


def parameters(model: GaussianModel, camera: Camera) -> dict[str, torch.Tensor]:
    """Everything differentiable, as float64 leaves."""
    arrays = {
        "means": model.means,
        "quats": model.quats,
        "log_scales": model.log_scales,
        "opacity_logits": model.opacity_logits,
        "sh": model.sh,
        "viewmat": camera.viewmat,
        "K": camera.K,
    }
    return {k: torch.tensor(v, dtype=torch.float64, requires_grad=True) for k, v in arrays.items()}


def rotations(quats: torch.Tensor) -> torch.Tensor:
    w, x, y, z = (quats / quats.norm(dim=1, keepdim=True)).unbind(1)
    rows = [
        1 - 2 * (y * y + z * z),
        2 * (x * y - w * z),
        2 * (x * z + w * y),
        2 * (x * y + w * z),
        1 - 2 * (x * x + z * z),
        2 * (y * z - w * x),
        2 * (x * z - w * y),
        2 * (y * z + w * x),
        1 - 2 * (x * x + y * y),
    ]
    return torch.stack(rows, 1).reshape(-1, 3, 3)


def colors_seen(p: dict[str, torch.Tensor]) -> torch.Tensor:
    R, t = p["viewmat"][:3, :3], p["viewmat"][:3, 3]
    d = p["means"] - (-R.T @ t)
    d = d / d.norm(dim=1, keepdim=True)
    return (0.5 + torch.einsum("nk,nkc->nc", sh_basis_torch(d, p["sh"].shape[1]), p["sh"])).clamp_min(0.0)


def sh_basis_torch(d: torch.Tensor, coefficients: int) -> torch.Tensor:
    """The basis as polynomials fitted to `sh_basis`: the same functions, differentiable."""
    x, y, z = d.unbind(1)
    powers = [(a, b, c) for a in range(4) for b in range(4) for c in range(4) if a + b + c <= 3]
    probe = np.random.default_rng(0).normal(size=(200, 3))
    probe /= np.linalg.norm(probe, axis=1, keepdims=True)
    rows = np.stack([probe[:, 0] ** a * probe[:, 1] ** b * probe[:, 2] ** c for a, b, c in powers], 1)
    degree = {1: 0, 4: 1, 9: 2, 16: 3}[coefficients]
    weights = np.linalg.lstsq(rows, sh_basis(probe, degree), rcond=None)[0]
    monomials = torch.stack([x**a * y**b * z**c for a, b, c in powers], 1)
    return monomials @ torch.tensor(weights)


def project(
    p: dict[str, torch.Tensor], width: int, height: int, settings: RasterSettings
) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor, torch.Tensor]:
    """Centres (N, 2), covariances (N, 2, 2), depths (N,), and which Gaussians are drawn."""
    R, t, K = p["viewmat"][:3, :3], p["viewmat"][:3, 3], p["K"]
    fx, fy, cx, cy = K[0, 0], K[1, 1], K[0, 2], K[1, 2]
    skew = (K[0, 1] / fx).detach()  # of which the engine has no gradients
    x, y, z = (p["means"] @ R.T + t).unbind(1)
    x = x + skew * y
    z_safe = torch.where(z > settings.near, z, torch.ones_like(z))
    margin_x, margin_y = FRUSTUM_MARGIN * 0.5 * width / fx, FRUSTUM_MARGIN * 0.5 * height / fy
    tx = torch.minimum(torch.maximum(x / z_safe, -cx / fx - margin_x), (width - cx) / fx + margin_x)
    ty = torch.minimum(torch.maximum(y / z_safe, -cy / fy - margin_y), (height - cy) / fy + margin_y)
    zero = torch.zeros_like(z)
    J = torch.stack([fx / z_safe, fx * skew / z_safe, -fx * tx / z_safe, zero, fy / z_safe, -fy * ty / z_safe], 1)
    P = J.reshape(-1, 2, 3) @ R @ rotations(p["quats"]) * p["log_scales"].exp()[:, None, :]
    covariances = P @ P.transpose(1, 2) + settings.eps2d * torch.eye(2, dtype=torch.float64)
    centres = torch.stack([fx * x / z_safe + cx, fy * y / z_safe + cy], 1)
    drawn = (z > settings.near) & (covariances.diagonal(dim1=1, dim2=2).amax(1) <= MAX_SIGMA_PX**2)
    return centres, covariances, z, drawn


def rasterize(
    p: dict[str, torch.Tensor],
    width: int,
    height: int,
    settings: RasterSettings = RasterSettings(),
    colors: torch.Tensor | None = None,
    background: float = 0.0,
    early: tuple[np.ndarray, float] | None = None,
) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    """Image (H, W, C), alpha (H, W), and every Gaussian's blending weights (N, H, W).

    `early` are W (N,) and tau of the paper's stop: the pixel ends behind the Gaussian that brings sum alpha W to tau.
    """
    reached = torch.zeros(height, width, dtype=torch.float64)
    centres, covariances, depths, drawn = project(p, width, height, settings)
    colors = colors_seen(p) if colors is None else colors
    opacities = torch.sigmoid(p["opacity_logits"])
    rows, columns = torch.meshgrid(
        torch.arange(height, dtype=torch.float64) + 0.5, torch.arange(width, dtype=torch.float64) + 0.5, indexing="ij"
    )
    transmittance = torch.ones(height, width, dtype=torch.float64)
    ended = torch.zeros(height, width, dtype=torch.bool)
    image = torch.zeros(height, width, colors.shape[1], dtype=torch.float64)
    weights = torch.zeros(len(colors), height, width, dtype=torch.float64)
    none = torch.zeros(height, width, dtype=torch.float64)
    if settings.by_distance:
        depths = torch.linalg.norm(p["means"] @ p["viewmat"][:3, :3].T + p["viewmat"][:3, 3], dim=1)
    nearest_first = np.argsort(depths.detach().numpy().astype(np.float32), kind="stable")
    for i in nearest_first:
        if not drawn[i]:
            continue
        conic = torch.linalg.inv(covariances[i])
        dx, dy = columns - centres[i, 0], rows - centres[i, 1]
        power = conic[0, 0] * dx * dx + 2 * conic[0, 1] * dx * dy + conic[1, 1] * dy * dy
        alpha = opacities[i] * torch.exp(-0.5 * power)
        if settings.antialiased:
            sharp = covariances[i] - settings.eps2d * torch.eye(2, dtype=torch.float64)
            kept = torch.linalg.det(sharp) / torch.linalg.det(covariances[i])
            alpha = alpha * torch.sqrt(torch.clamp(kept, min=1e-6))
        blended = (alpha >= settings.alpha_skip) & ~ended
        alpha = alpha.clamp_max(settings.alpha_clamp)
        after = transmittance * (1 - alpha)
        ends = blended & (after <= settings.transmittance_stop)
        ended = ended | ends
        blended = blended & ~ends
        weight = torch.where(blended, alpha * transmittance, none)
        weights[i] = weight.detach()
        image = image + weight[..., None] * colors[i]
        transmittance = torch.where(blended, after, transmittance)
        if early is not None:
            reached = reached + torch.where(blended, alpha * float(early[0][i]), none)
            ended = ended | (reached >= early[1])
    return image + transmittance[..., None] * background, 1 - transmittance, weights
