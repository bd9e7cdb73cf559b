"""Discs (2DGS) and clips (4DGS) made from ordinary models, since no captured files of these kinds are at hand.

Discs are **made, not trained**: a Gaussian model loses its smallest axis, its discs are widened by what a 3DGS
rasterizer adds to every splat, and their colors are fitted to renders of the original. A trained 2DGS also has
surfaces that agree with each other, and normals; what matters to a mark is alike: two scales, the ray-splat
intersection, colors that a 2DGS viewer shows.

A clip starts from a *truth*, a scene that sways in low-order modes and some parts of which appear and vanish; from it a
Spacetime model is **fitted by least squares**, as a capture of that scene would be: cubics cannot follow the sines
exactly, nor radial bases the way things appear. So there is a quality before marking, as Table 4 needs one. The motion
is made, not measured, and every result must say so.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from engine.compress.cells import split_cells
from engine.errors import InputError
from engine.flows.views.camera_rig import UP, make_rig, measure_extent
from engine.lab.sim.adversaries.retraining import fine_tune
from engine.model import SH_C0, Camera, Float32, Float64, GaussianModel
from engine.numerics.gaussians import flatten
from engine.numerics.similarity import quaternion_product
from engine.raster import RasterSettings, render
from engine.scenes.spacetime import LOGIT_LIMIT, SpacetimeModel

FIT_VIEWS, FIT_SIZE, FIT_EPOCHS = 12, 512, 2
"""Views of the regular rig, pixels a side, and passes over them, in which colors are fitted."""


def make_discs(
    model: GaussianModel, epochs: int = FIT_EPOCHS, advance: Callable[[float], None] | None = None
) -> GaussianModel:
    """A 3DGS model as discs that look like it, in its order: flattened, widened, colors fitted (see `fit_colors`)."""
    cameras = make_rig(model, FIT_VIEWS, FIT_SIZE, FIT_SIZE)
    return fit_colors(widen(flatten(model), cameras), model, cameras, epochs, advance)


def widen(discs: GaussianModel, cameras: Sequence[Camera]) -> GaussianModel:
    """Discs with the dilation that 3DGS adds on the screen folded into their scales.

    EWA splatting adds `eps2d` square pixels to both variances of every splat, 2DGS nothing. Here that amount goes
    to the two scales, at the mean magnification (pixels a scene unit) of the cameras that see the disc's center in
    front of them, which have the size in pixels at which the discs are to look right. Measured on real scenes: 4 to
    5 dB.
    """
    if not cameras:
        raise InputError("discs are widened for cameras, none was given")
    settings = RasterSettings()
    magnification, seen = np.zeros(len(discs)), np.zeros(len(discs))
    for camera in cameras:
        z = discs.means @ camera.viewmat[2, :3] + camera.viewmat[2, 3]
        ahead = z > settings.near
        magnification[ahead] += np.sqrt(camera.K[0, 0] * camera.K[1, 1]) / z[ahead]
        seen += ahead
    pixels = magnification / np.maximum(seen, 1.0)  # of one scene unit; 0 where no camera looks
    added = settings.eps2d / np.maximum(pixels, 1e-30) ** 2 * (seen > 0)
    log_scales = discs.log_scales.copy()
    variances = np.exp(2.0 * log_scales[:, :2].astype(np.float64)) + added[:, None]
    log_scales[:, :2] = 0.5 * np.log(variances)
    return flatten(discs.with_(log_scales=log_scales))


def fit_colors(
    discs: GaussianModel,
    original: GaussianModel,
    cameras: Sequence[Camera],
    epochs: int,
    advance: Callable[[float], None] | None = None,
) -> GaussianModel:
    """The discs with SH fitted to renders of the original 3DGS model; geometry and opacity are held.

    So many passes of Adam over the views (see `fine_tune`); 0 gives the discs back. `advance` gets the part done.
    """
    if epochs == 0:
        return discs
    truth = [np.clip(render(original, camera), 0.0, 1.0) for camera in cameras]
    return discs.with_(sh=fine_tune(discs, cameras, truth, epochs, trained="colors", advance=advance).sh)


MODES = 4
FRAMES = 24  # moments of the truth that a fit sees
CENTERS = (0.35, 0.5, 0.65)  # temporal centers of what lasts; real captures spread them as well
SOFT = 0.02  # time in which something appears or vanishes, parts of the clip: a few frames
CELLS = 64  # parts of a scene that come and go as one
SHORTEST, MARGIN = 0.05, 0.2
"""Shortest life that is fitted, and how far beyond the clip a window counts, parts of the clip."""
UNSEEN = 1e-3  # weight of the moments at which a Gaussian cannot be seen: a fit stays solvable
ALWAYS = (-9.0, 9.0)  # window of what is always there
LASTING = np.log(4.0)  # log width of what lasts: at the ends of the clip it is still more than 97 % as opaque


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
    """Let a still scene sway about its foot, with parts of it coming and going; its view-dependent color is dropped.

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
