"""Dynamic scenes made from still ones: no real 4-D file is at hand, so a real scene is set in motion.

What is made is the *truth*, a scene that sways in low-order modes and some parts of which appear and vanish; and from
it a Spacetime model **fitted by least squares**, as a capture of that scene would be: cubics cannot follow the sines
exactly, nor radial bases the way things appear. So there is a quality before marking, as Table 4 needs one. The
motion is made, not measured, and every result must say so.
"""

from dataclasses import dataclass

import numpy as np

from engine.compress.cells import split_cells
from engine.errors import InputError
from engine.flows.views.camera_rig import UP, measure_extent
from engine.model import SH_C0, Float32, Float64, GaussianModel
from engine.numerics.similarity import quaternion_product
from engine.scenes.spacetime import LOGIT_LIMIT, SpacetimeModel

__all__ = ["SwayingScene", "fit_spacetime", "set_in_motion"]

MODES = 4
FRAMES = 24
"""Moments of the truth that a fit sees."""
CENTERS = (0.35, 0.5, 0.65)
"""Temporal centres of what lasts; real captures spread them as well."""
SOFT = 0.02
"""Time in which something appears or vanishes, parts of the clip: a few frames."""
CELLS = 64
"""Parts of a scene that come and go as one."""
SHORTEST, MARGIN = 0.05, 0.2
"""Shortest life that is fitted, and how far beyond the clip a window counts, parts of the clip."""
UNSEEN = 1e-3
"""Weight of the moments at which a Gaussian cannot be seen: a fit stays solvable."""
ALWAYS = (-9.0, 9.0)
"""Window of what is always there."""
LASTING = np.log(4.0)
"""Log width of what lasts: at the ends of the clip it is still more than 97 % as opaque."""


@dataclass(frozen=True, eq=False)
class SwayingScene:
    """A still scene of SH degree 0 and how it moves; exact at any moment from 0 to 1."""

    still: GaussianModel
    height: Float64  # (N,) 0 at the foot, which does not move, to 1 at the top
    waves: Float64  # (MODES, 3) wave vectors, radians per scene unit
    directions: Float64  # (MODES, 3) displacement at full swing, scene units
    frequencies: Float64  # (MODES,) swings per clip
    phases: Float64  # (MODES,) radians
    window: Float64  # (N, 2) from when to when each Gaussian is there; beyond 0 to 1 for most

    def at(self, time: float) -> GaussianModel:
        """All Gaussians at a moment, swayed, turned with the sway, and faded where their window ends."""
        angle = self.still.means @ self.waves.T + 2 * np.pi * self.frequencies * time + self.phases  # (N, M)
        reach = (self.height**1.5)[:, None]
        moved = reach * (np.sin(angle) @ self.directions)
        # Half the curl of the displacement is the rotation of a small piece; the reach varies slowly.
        curl = np.cross(self.waves[None], self.directions[None])  # (1, M, 3)
        turn = 0.5 * reach * np.einsum("nm,nmc->nc", np.cos(angle), np.broadcast_to(curl, (*angle.shape, 3)))
        size = np.linalg.norm(turn, axis=1, keepdims=True)
        axis = turn / np.maximum(size, 1e-12)
        spin = np.concatenate([np.cos(size / 2), np.sin(size / 2) * axis], axis=1)
        start, end = self.window.T
        shown = 1.0 / ((1 + np.exp((start - time) / SOFT)) * (1 + np.exp((time - end) / SOFT)))
        opacity = np.clip(self.still.opacities * shown, 1e-12, 1 - 1e-7)
        return self.still.with_(
            means=(self.still.means + moved).astype(np.float32),
            quats=quaternion_product(spin, self.still.quats).astype(np.float32),
            opacity_logits=np.log(opacity / (1 - opacity)).astype(np.float32),
        )


def set_in_motion(model: GaussianModel, *, swing: float = 0.04, transient: float = 0.1, seed: int = 0) -> SwayingScene:
    """Let a still scene sway about its foot, with parts of it coming and going; its view-dependent colour is dropped.

    `swing` is the largest displacement, in radii of the scene; `transient` the share, 0 to 1, of its cells that are not
    there all the time.
    """
    if not 0.0 <= swing <= 1.0 or not 0.0 <= transient <= 1.0:
        raise InputError(f"swing and transient must lie in 0..1, got {swing:g} and {transient:g}")
    rng = np.random.default_rng(seed)
    extent = measure_extent(model)
    up = model.means.astype(np.float64) @ UP
    low, high = np.quantile(up, [0.05, 0.98])
    amplitude = swing * extent.radius * 0.5 ** np.arange(MODES)
    across = rng.standard_normal((MODES, 3))
    across -= np.outer(across @ UP, UP)
    cells = split_cells((model.means / extent.radius).astype(np.float32), np.ones(len(model)), CELLS)
    part = np.tile(ALWAYS, (int(cells.max()) + 1, 1))
    chosen = rng.random(len(part)) < transient
    begin = rng.uniform(-0.2, 0.7, len(part))
    part[chosen] = np.stack([begin, begin + rng.uniform(0.15, 0.5, len(part))], axis=1)[chosen]
    return SwayingScene(
        model.with_(sh=model.sh[:, :1]),
        np.clip((up - low) / max(high - low, 1e-12), 0.0, 1.0),
        rng.standard_normal((MODES, 3)) * np.linspace(0.5, 2.0, MODES)[:, None] / extent.radius,
        amplitude[:, None] * across / np.linalg.norm(across, axis=1, keepdims=True),
        rng.uniform(0.4, 1.0, MODES),
        rng.uniform(0.0, 2 * np.pi, MODES),
        part[cells],
    )


def fit_spacetime(scene: SwayingScene) -> SpacetimeModel:
    """The Spacetime model nearest to a scene: cubics, linear rotation and lifetimes by weighted least squares."""
    n = len(scene.still)
    times = np.linspace(0.0, 1.0, FRAMES)
    start, end = np.clip(scene.window, -MARGIN, 1.0 + MARGIN).T
    lasts = (scene.window[:, 0] < -1) & (scene.window[:, 1] > 2)
    center = np.where(lasts, np.asarray(CENTERS)[np.arange(n) % len(CENTERS)], 0.5 * (start + end))
    # A window of width w and the basis exp(-(d/s)^2) cover the same area for s = w / sqrt(pi).
    width = np.where(lasts, LASTING, np.log(np.maximum(end - start, SHORTEST) / np.sqrt(np.pi)))
    frames = [scene.at(time) for time in times]
    means, motion = np.empty((n, 3)), np.empty((n, 9))
    quats, omega = np.empty((n, 4)), np.empty((n, 4))
    for value in np.unique(np.stack([center, width], axis=1), axis=0):  # as many as there are cells
        rows = np.flatnonzero((center == value[0]) & (width == value[1]))
        d = times - value[0]
        weights = np.exp(-((d / np.exp(value[1])) ** 2)) + UNSEEN
        places = np.stack([frame.means[rows] for frame in frames]).reshape(FRAMES, -1)  # (T, 3 n)
        fit = _fit(d, weights, 3, places).reshape(4, len(rows), 3)  # by degree
        means[rows], motion[rows] = fit[0], np.moveaxis(fit[1:], 0, 1).reshape(len(rows), 9)
        turns = np.stack([frame.quats[rows] for frame in frames])  # (T, n, 4)
        turns = turns * np.where((turns * turns[:1]).sum(axis=2, keepdims=True) < 0, -1.0, 1.0)
        quats[rows], omega[rows] = _fit(d, weights, 1, turns.reshape(FRAMES, -1)).reshape(2, len(rows), 4)
    logits = np.clip(scene.still.opacity_logits, -LOGIT_LIMIT, LOGIT_LIMIT)
    colors = 0.5 + SH_C0 * scene.still.sh[:, 0]
    parts = (means, scene.still.log_scales, quats, logits, colors, center, width, motion, omega)
    return SpacetimeModel(*(part.astype(np.float32) for part in parts))


def _fit(d: Float64, weights: Float64, degree: int, values: Float64 | Float32) -> Float64:
    """(degree + 1, columns) coefficients of polynomials in d, lowest first, by weighted least squares."""
    root = np.sqrt(weights)[:, None]
    design = d[:, None] ** np.arange(degree + 1) * root
    return np.asarray(np.linalg.lstsq(design, values.astype(np.float64) * root, rcond=None)[0])
