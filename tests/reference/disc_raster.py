"""The image of discs (2DGS), defined the slow way: every disc over every pixel, in float64, nearest first.

Written from Huang et al. 2024, equations 4 to 11: a pixel's ray is the meeting of two planes, both are taken
to the disc's own frame by the transposed homography, and their line meets u, v there.
"""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from engine.model import Camera, GaussianModel
from engine.raster.settings import MAX_SIGMA_PX, RasterSettings


def homographies(model: GaussianModel, camera: Camera) -> np.ndarray:
    """(N, 4, 4): (u, v, 1, 1) of the disc's frame to (x z, y z, z, 1), x and y in pixels (equations 5 and 6, W H)."""
    screen = np.eye(4)
    screen[:3, :3] = camera.K
    world_to_screen = screen @ camera.viewmat
    axes = Rotation.from_quat(model.quats.astype(np.float64)[:, [1, 2, 3, 0]]).as_matrix()
    scales = np.exp(model.log_scales.astype(np.float64))
    H = np.zeros((len(model), 4, 4))
    H[:, :3, 0] = scales[:, :1] * axes[:, :, 0]
    H[:, :3, 1] = scales[:, 1:2] * axes[:, :, 1]
    H[:, :3, 3] = model.means
    H[:, 3, 3] = 1.0
    return world_to_screen @ H


def rasterize(
    model: GaussianModel,
    camera: Camera,
    colors: np.ndarray,
    settings: RasterSettings = RasterSettings(),
    background: float = 0.0,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Image (H, W, C), alpha (H, W), and every disc's blending weights (N, H, W)."""
    height, width = camera.height, camera.width
    y, x = np.mgrid[:height, :width] + 0.5
    WH = homographies(model, camera)
    opacities = 1.0 / (1.0 + np.exp(-model.opacity_logits.astype(np.float64)))
    transmittance, ended = np.ones((height, width)), np.zeros((height, width), bool)
    image, weights = np.zeros((height, width, colors.shape[1])), np.zeros((len(model), height, width))
    away = np.linalg.norm(model.means @ camera.viewmat[:3, :3].T + camera.viewmat[:3, 3], axis=1)
    depths = away if settings.by_distance else WH[:, 2, 3]
    for i in np.argsort(depths.astype(np.float32), kind="stable"):
        depth = WH[i, 2, 3]
        if depth <= settings.near:
            continue
        cx, cy = WH[i, 0, 3] / depth, WH[i, 1, 3] / depth
        per_sigma = (WH[i, :2, :2] - np.outer([cx, cy], WH[i, 2, :2])) / depth
        if (per_sigma**2).sum(axis=1).max() > MAX_SIGMA_PX**2:
            continue
        u, v, z = meet(WH[i], x, y)
        with np.errstate(over="ignore"):
            disc = np.where(z > 0, np.exp(-0.5 * np.minimum(u * u + v * v, 1e4)), 0.0)
        low_pass = np.exp(-0.5 * ((x - cx) ** 2 + (y - cy) ** 2) / (np.sqrt(2) / 2) ** 2)
        alpha = opacities[i] * np.maximum(disc, low_pass)
        blended = (alpha >= settings.alpha_skip) & ~ended
        alpha = np.minimum(alpha, settings.alpha_clamp)
        after = transmittance * (1 - alpha)
        ends = blended & (after <= settings.transmittance_stop)
        ended |= ends
        weights[i] = np.where(blended & ~ends, alpha * transmittance, 0.0)
        image += weights[i][..., None] * colors[i]
        transmittance = np.where(blended & ~ends, after, transmittance)
    return image + transmittance[..., None] * background, 1 - transmittance, weights


def meet(WH: np.ndarray, x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Where the rays of pixels x, y meet a disc's plane: u, v, and the depth there, z (<= 0: behind the camera).

    Parameters
    ----------
    WH : (4, 4)
    x, y : (...)
    """
    h_u = -WH[0] + x[..., None] * WH[2]  # (WH)^T (-1, 0, x, 0): the plane of all points seen in column x
    h_v = -WH[1] + y[..., None] * WH[2]
    with np.errstate(divide="ignore", invalid="ignore"):
        below = h_u[..., 0] * h_v[..., 1] - h_u[..., 1] * h_v[..., 0]
        u = (h_u[..., 1] * h_v[..., 3] - h_u[..., 3] * h_v[..., 1]) / below  # equation 9
        v = (h_u[..., 3] * h_v[..., 0] - h_u[..., 0] * h_v[..., 3]) / below
        z = WH[2, 0] * u + WH[2, 1] * v + WH[2, 3]
    return u, v, np.nan_to_num(z, nan=-1.0, posinf=-1.0, neginf=-1.0)
