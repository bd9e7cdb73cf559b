"""Models that nobody would train and somebody will upload: each is to be marked and verified, or refused in words."""

from collections.abc import Callable

import numpy as np

from engine.model import GaussianModel

__all__ = ["FEW", "ODD", "QUICK"]

FEW = (1, 2, 10, 63, 64, 100)
"""Numbers of Gaussians, about the least that a mark needs (64)."""


def _few(count: int) -> Callable[[GaussianModel], GaussianModel]:
    def make(model: GaussianModel) -> GaussianModel:
        return model.take(np.linspace(0, len(model) - 1, count).astype(np.int64))

    return make


def _identical(model: GaussianModel) -> GaussianModel:
    return model.take(np.zeros(5_000, dtype=np.int64))


def _transparent(model: GaussianModel) -> GaussianModel:
    return model.with_(opacity_logits=np.full(len(model), -20.0, dtype=np.float32))


def _opaque(model: GaussianModel) -> GaussianModel:
    return model.with_(opacity_logits=np.full(len(model), 80.0, dtype=np.float32))


def _sized(log_factor: float) -> Callable[[GaussianModel], GaussianModel]:
    def make(model: GaussianModel) -> GaussianModel:
        return model.with_(log_scales=model.log_scales + np.float32(log_factor))

    return make


def _needles(model: GaussianModel) -> GaussianModel:
    scales = model.log_scales.copy()
    scales[:, 1:] = scales[:, :1] - np.float32(12.0)
    return model.with_(log_scales=scales)


def _discs(model: GaussianModel) -> GaussianModel:
    scales = model.log_scales.copy()
    scales[:, 2] = scales[:, :2].min(axis=1) - np.float32(12.0)
    return model.with_(log_scales=scales)


def _coincident(model: GaussianModel) -> GaussianModel:
    return model.with_(means=np.broadcast_to(np.median(model.means, axis=0), model.means.shape))


def _paired(model: GaussianModel) -> GaussianModel:
    return model.take(np.repeat(np.arange(len(model)), 2))


def _far(distance: float) -> Callable[[GaussianModel], GaussianModel]:
    def make(model: GaussianModel) -> GaussianModel:
        return model.with_(means=model.means + np.float32(distance))

    return make


def _one_color(model: GaussianModel) -> GaussianModel:
    sh = np.zeros_like(model.sh)
    sh[:, 0] = 0.3
    return model.with_(sh=sh)


def _no_sh(model: GaussianModel) -> GaussianModel:
    return model.with_(sh=model.sh[:, :1])


def _on_a_line(model: GaussianModel) -> GaussianModel:
    means = model.means.copy()
    means[:, 1:] = 0.0
    return model.with_(means=means)


def _largest_scales(model: GaussianModel) -> GaussianModel:
    scales = model.log_scales.copy()
    scales[::100] = 88.0  # exp of it is close to float32's largest number
    scales[1::100] = -100.0
    return model.with_(log_scales=scales)


def _largest_centers(model: GaussianModel) -> GaussianModel:
    means = model.means.copy()
    means[::100] = np.finfo(np.float32).max
    means[1::100] = -np.finfo(np.float32).max
    return model.with_(means=means)


def _largest_colors(model: GaussianModel) -> GaussianModel:
    sh = model.sh.copy()
    sh[::100] = np.finfo(np.float32).max
    sh[1::100] = -np.finfo(np.float32).max
    return model.with_(sh=sh)


def _largest_opacities(model: GaussianModel) -> GaussianModel:
    logits = model.opacity_logits.copy()
    logits[::2] = np.finfo(np.float32).max
    logits[1::100] = -np.finfo(np.float32).max
    return model.with_(opacity_logits=logits)


def _smallest_numbers(model: GaussianModel) -> GaussianModel:
    tiny = np.float32(1e-42)  # a denormal
    return model.with_(means=model.means * tiny, log_scales=model.log_scales - np.float32(96.0))


ODD: dict[str, Callable[[GaussianModel], GaussianModel]] = {
    **{f"{count} Gaussians": _few(count) for count in FEW},
    "all identical": _identical,
    "all transparent": _transparent,
    "all opaque": _opaque,
    "scales x 1e4": _sized(9.2),
    "scales x 1e-8": _sized(-18.4),
    "needles": _needles,
    "discs": _discs,
    "coincident centres": _coincident,
    "every Gaussian twice": _paired,
    "centres on a line": _on_a_line,
    "1e3 from the origin": _far(1e3),
    "1e6 from the origin": _far(1e6),
    "1e30 from the origin": _far(1e30),
    "one colour": _one_color,
    "no SH above DC": _no_sh,
    "float32 extremes: scales": _largest_scales,
    "float32 extremes: centres": _largest_centers,
    "float32 extremes: colours": _largest_colors,
    "float32 extremes: opacities": _largest_opacities,
    "float32 extremes: denormals": _smallest_numbers,
}
"""Name of each odd input, and how it is made of a real piece of a scene."""

QUICK = ("10 Gaussians", "100 Gaussians", "all transparent", "coincident centres", "1e6 from the origin")
"""Those of a quick run."""
