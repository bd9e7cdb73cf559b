"""Random scenes, and how close results must come to the slow twin."""

from __future__ import annotations

from typing import Any

import numpy as np

from engine.model import DISC_THICKNESS, Camera, Float32, GaussianModel, look_at

TOLERANCE = {
    "pixel": 3e-3,  # a pixel where float32 falls on the other side of a threshold (1/255, the pixel's end)
    "most pixels": 3e-6,  # 99.9 % of them
    "most disc pixels": 1e-5,  # discs have no dilation: of a thin one, float32 places the edge less exactly
    "gradient": 5e-4,  # relative L2
    "typical gradient": 1e-5,  # relative L2 where no threshold is near
    "finite difference": 1e-4,  # relative L2, float64 differences of the twin
    "exp2": 4e-7,  # relative
    "log2": 5e-7,  # absolute
}


def random_model(count: int, seed: int, coefficients: int = 16) -> GaussianModel:
    """Gaussians around the origin, some behind the camera, some large, some faint, of any shape."""
    rng = np.random.default_rng(seed)

    def normal(mean: float, scale: float, *shape: int) -> Float32:
        return rng.normal(mean, scale, shape).astype(np.float32)

    return GaussianModel(
        normal(0.0, 1.0, count, 3),
        normal(-2.2, 0.9, count, 3),
        normal(0.0, 1.0, count, 4),
        normal(0.0, 2.0, count),
        normal(0.0, 0.4, count, coefficients, 3),
    )


def random_discs(count: int, seed: int, coefficients: int = 16) -> GaussianModel:
    """The same as discs of 2DGS: the third scale next to nothing."""
    model = random_model(count, seed, coefficients)
    log_scales = model.log_scales.copy()
    log_scales[:, 2] = log_scales[:, :2].min(axis=1) + np.log(DISC_THICKNESS)
    return model.with_(log_scales=log_scales)


def camera(width: int = 53, height: int = 47, focal: float = 60.0) -> Camera:
    """Close to the random models, so that some Gaussians cross its near plane and its border."""
    return look_at((0.5, -1.0, -2.6), (0.0, 0.4, 0.0), (0.0, -1.0, 0.0), focal, width, height)


def relative(result: Any, expected: Any) -> float:
    """Relative L2 distance."""
    result, expected = np.asarray(result, np.float64), np.asarray(expected, np.float64)
    return float(np.linalg.norm(result - expected) / max(np.linalg.norm(expected), 1e-30))


def assert_same_image(result: Any, expected: Any, most: str = "most pixels") -> None:
    """As the tolerance table says."""
    difference = np.abs(np.asarray(result, np.float64) - np.asarray(expected, np.float64))
    assert difference.shape == np.shape(expected)
    assert difference.max() <= TOLERANCE["pixel"]
    assert np.quantile(difference, 0.999) <= TOLERANCE[most]
