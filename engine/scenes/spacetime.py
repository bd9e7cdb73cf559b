"""Spacetime Gaussians: Gaussians that live about a moment, move along cubics and turn at a constant rate.

The representation of Li, Chen, Li and Xu, "Spacetime Gaussian Feature Splatting for Real-Time Dynamic View
Synthesis" (CVPR 2024), in its "lite" form, whose colours are plain RGB that does not change with time.
"""

from __future__ import annotations

import hashlib
from dataclasses import dataclass, replace

import numpy as np

from engine.errors import InputError
from engine.model import SH_C0, Float32, Float64, GaussianModel

__all__ = ["SpacetimeModel"]

LOGIT_LIMIT = 80.0
"""Opacities are kept this far from 0 and 1, as logits; the PLY reader clamps at the same value."""

MOMENTS = 33
"""Moments at which a lifetime is sampled for `persistence`."""


@dataclass(frozen=True, eq=False)
class SpacetimeModel:
    """N Gaussians in space and time, arrays as the public code stores them.

    With d = t - trbf_center, at time t a Gaussian has

    * opacity sigmoid(opacity_logit) * exp(-(d / exp(trbf_scale))^2),
    * centre mean + motion[0:3] d + motion[3:6] d^2 + motion[6:9] d^3,
    * rotation normalize(quat + omega d).
    """

    means: Float32  # (N, 3) centres at the temporal centre, scene units
    log_scales: Float32  # (N, 3) natural logarithm of the standard deviations
    quats: Float32  # (N, 4) rotation w, x, y, z at the temporal centre; their length matters relative to `omega`
    opacity_logits: Float32  # (N,) at the temporal centre
    colors: Float32  # (N, 3) RGB as it shows, nominal range 0 to 1, constant in time
    trbf_center: Float32  # (N,) of the temporal radial basis, in units of the clip's duration
    trbf_scale: Float32  # (N,) logarithm of its width in these units
    motion: Float32  # (N, 9) coefficients of degree 1, 2 and 3, three coordinates each
    omega: Float32  # (N, 4) change of the quaternion per unit of time

    def __post_init__(self) -> None:
        n = len(self.means)
        widths = (3, 3, 4, 0, 3, 0, 0, 9, 4)  # of the fields in their order; 0 is one number each
        for name, width in zip(self.__dataclass_fields__, widths, strict=True):
            shape = (n, width) if width else (n,)
            array = np.ascontiguousarray(getattr(self, name), dtype=np.float32)
            if array.shape != shape:
                raise InputError(f"{name} has shape {array.shape}, expected {shape}")
            object.__setattr__(self, name, array)

    def __len__(self) -> int:
        return len(self.means)

    @property
    def span(self) -> tuple[float, float]:
        """First and last moment of the clip, which by convention lasts from 0 to 1."""
        return 0.0, 1.0

    def at(self, time: float, displaced: GaussianModel | None = None) -> GaussianModel:
        """All N Gaussians at a moment (units of the clip), also those that are not visible then; SH degree 0.

        As if `displaced` were the canonical model, where given.
        """
        if displaced is not None:
            return self.displaced(displaced).at(time)
        if not np.isfinite(time):
            raise InputError(f"a moment must be a finite number, got {time}")
        d = (time - self.trbf_center.astype(np.float64))[:, None]  # (N, 1)
        motion = self.motion.astype(np.float64)
        means = self.means + d * (motion[:, 0:3] + d * (motion[:, 3:6] + d * motion[:, 6:9]))
        quats = _unit(self.quats + d * self.omega.astype(np.float64))
        logits = _fade(self.opacity_logits.astype(np.float64), self._distance2(time))
        return GaussianModel(
            means.astype(np.float32), self.log_scales, quats, logits.astype(np.float32), self._dc()[:, None]
        )

    def canonical(self) -> GaussianModel:
        """Every Gaussian at its own temporal centre, where it is as opaque as it ever gets.

        No single moment shows this model, but each Gaussian of the clip is in it once, and re-timing the clip
        (another start, speed or direction) does not change it.
        """
        quats = _unit(self.quats.astype(np.float64))
        return GaussianModel(self.means, self.log_scales, quats, self.opacity_logits, self._dc()[:, None])

    def persistence(self) -> Float32:
        """(N,) mean of the temporal basis over the clip, 0 to 1: how lasting each Gaussian is."""
        total = np.zeros(len(self))
        for time in np.linspace(*self.span, MOMENTS):
            total += np.exp(-self._distance2(time))
        return (total / MOMENTS).astype(np.float32)

    def displaced(self, canonical: GaussianModel) -> SpacetimeModel:
        """A copy that has the centres at its temporal centres, the sizes and DC coefficients of this model (N)."""
        colors = self.colors + np.float32(SH_C0) * (canonical.sh[:, 0] - self._dc())
        return replace(self, means=canonical.means, log_scales=canonical.log_scales, colors=colors)

    def digest(self) -> str:
        """SHA-256 over all arrays, hexadecimal."""
        whole = hashlib.sha256(b"spacetime 1")
        for name in self.__dataclass_fields__:
            whole.update(np.ascontiguousarray(getattr(self, name), dtype="<f4").tobytes())
        return whole.hexdigest()

    def _distance2(self, time: float) -> Float64:
        """(N,) squared distance from the temporal centre, in widths."""
        d = time - self.trbf_center.astype(np.float64)
        return np.asarray((d * np.exp(-self.trbf_scale.astype(np.float64))) ** 2)

    def _dc(self) -> Float32:
        return (self.colors - np.float32(0.5)) / np.float32(SH_C0)


def _unit(quats: Float64) -> Float32:
    """Unit quaternions; a zero one is no rotation."""
    norm = np.linalg.norm(quats, axis=1, keepdims=True)
    unit = np.where(norm > 0, quats / np.maximum(norm, 1e-300), [1.0, 0.0, 0.0, 0.0])
    return unit.astype(np.float32)


def _fade(logits: Float64, distance2: Float64) -> Float64:
    """Logit of sigmoid(logit) * exp(-distance2), without loss however small the result is."""
    log_opacity = -np.logaddexp(0.0, -logits) - distance2
    # 1 - p = (1 - sigmoid) + sigmoid (1 - exp(-d2)): no cancellation where p is near 1
    rest = np.exp(-np.logaddexp(0.0, logits)) - np.exp(-np.logaddexp(0.0, -logits)) * np.expm1(-distance2)
    return np.asarray(np.clip(log_opacity - np.log(np.maximum(rest, 1e-300)), -LOGIT_LIMIT, LOGIT_LIMIT))
