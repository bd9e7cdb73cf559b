"""Refine a camera on brightness: robust Gauss-Newton against fresh renders, coarse to fine (DESIGN 4.8).

The model of the picture is suspect(x) = gain render(x; camera) + offset alpha(x) + (1 - alpha(x)) behind(x), alpha the
render's opacity, behind what the picture shows where that is clear (`background`). A small motion of the camera moves
what a pixel shows by a flow that follows from its depth, and so changes its brightness by -gradient . flow:
one render with depth gives all columns of the linearised problem. The residual is always that of an
exact render, so where the iteration stops, depth edges and haze have not biased it; they only slow it down.

Gradients are those of the noise-free render, so noise in the picture does not bias the fit either.
"""

# mypy: allow-untyped-defs

from dataclasses import dataclass

import numpy as np

from engine.kernels.jit import inlined, parallel_kernel, share_of
from engine.kernels.thread_crew import thread_count
from engine.model import Camera, Float32, Float64, GaussianModel
from engine.numerics.resampling import smooth
from engine.pictures.alignment.background import fill_background
from engine.pictures.alignment.blur import Blur
from engine.pictures.alignment.brightness_fit import robust_line, robust_scale
from engine.pictures.alignment.config import CONFIG as ALIGNMENT
from engine.pictures.alignment.detail import compare_detail, correlation, uncovered
from engine.pictures.camera.camera_motion import CENTERED, PARAMETERS, moved
from engine.pictures.camera.config import CONFIG
from engine.pictures.landmarks.keypoints import luma
from engine.raster import RasterSettings, render_depth
from engine.raster.lane_ir import LANES
from engine.raster.lane_memory import load, store

_CONFIG = CONFIG.refinement
_UNKNOWNS = PARAMETERS + 2
# Of 16 pixels: columns and the residual, flow across and down, both weights; and how many sums of their products.
_FLOWS = (_UNKNOWNS + 1) * LANES
_WEIGHTS = _FLOWS + 2 * PARAMETERS * LANES
_BLOCK = _WEIGHTS + 2 * LANES
_PRODUCTS = _UNKNOWNS * (_UNKNOWNS + 3) // 2
_SUMS = _PRODUCTS + PARAMETERS * (PARAMETERS + 1) // 2


DEFAULT_SETTINGS = RasterSettings()
"""How most viewers draw."""


@dataclass(frozen=True, eq=False)
class Drawing:
    """How a render is made like a picture: the renderer's settings, and the blur that the picture is known to have."""

    settings: RasterSettings = DEFAULT_SETTINGS
    blur: Blur | None = None


@dataclass(frozen=True, eq=False)
class Refined:
    """A camera of the level's size and how well its render explains the picture."""

    camera: Camera
    rms: float  # robust standard deviation of the brightness residual, 0..1
    correlation: float  # of picture and render on the pixels used, -1..1
    uncovered_correlation: float  # of both where nothing lies over the model (`uncovered`)
    detail: float  # correlation there of the details that opacity does not explain (`compare_detail`)
    detail_z: float  # the same in standard deviations of chance on so many pixels
    step: float  # root mean square flow of the last motion, pixels of the level
    shift: float  # root mean square flow of a motion with all parameters free, pixels of the level
    pixels: int  # used

    @property
    def alike(self) -> bool:
        """Whether the picture shows what the render does, and not something else."""
        alike = self.uncovered_correlation > _CONFIG.least_correlation and self.detail > _CONFIG.least_detail
        return alike and self.detail_z > _CONFIG.least_detail_z

    @property
    def hopeful(self) -> bool:
        """Whether a larger picture may show it: of what is thin or small, too little is left in this."""
        return self.uncovered_correlation > _CONFIG.hopeful_correlation and self.detail > _CONFIG.hopeful_detail

    @property
    def gain(self) -> float:
        """How much likelier the render makes the picture than a flat colour does, as a logarithm."""
        return -0.5 * self.pixels * float(np.log(max(1.0 - max(self.correlation, 0.0) ** 2, 1e-9)))


@inlined
def _add_products(block, sums):
    """Adds the products of 16 pixels' columns, and of their flows, each weighted, to `sums`: upper triangles."""
    at = 0
    for k in range(_UNKNOWNS):
        weighted = load(block, _WEIGHTS) * load(block, k * LANES)
        for l in range(k, _UNKNOWNS + 1):
            store(sums, at, load(sums, at) + weighted * load(block, l * LANES))
            at += LANES
    for k in range(PARAMETERS):
        weight = load(block, _WEIGHTS + LANES)
        across, down = weight * load(block, _FLOWS + k * LANES), weight * load(block, _FLOWS + (PARAMETERS + k) * LANES)
        for l in range(k, PARAMETERS):
            both = across * load(block, _FLOWS + l * LANES) + down * load(block, _FLOWS + (PARAMETERS + l) * LANES)
            store(sums, at, load(sums, at) + both)
            at += LANES


@parallel_kernel
def _normal_equations(base, cover, residual, gx, gy, depth, weight, K, spread, room, rows, call):
    """The sums of each row of pixels, to `rows` (height, _SUMS); `room` is scratch."""
    height, width = base.shape
    block, sums = room[call[0], :_BLOCK], room[call[0], _BLOCK:]
    block[:] = np.float32(0.0)
    fx, skew, fy = K[0, 0], K[0, 1], K[1, 1]
    for j in share_of(height, call):
        sums[:] = np.float32(0.0)
        filled = 0
        b = (j + 0.5 - K[1, 2]) / fy
        for i in range(width):
            if weight[j, i] <= 0.0:
                continue
            a = (i + 0.5 - K[0, 2] - skew * b) / fx
            near = 1.0 / depth[j, i]
            u = -a * b, 1.0 + a * a, -b, near, 0.0, -a * near, a, 1.0, 0.0, a, b
            v = -1.0 - b * b, a * b, a, 0.0, near, -b * near, b, 0.0, 1.0, 0.0, 0.0
            for k in range(PARAMETERS):
                across, down = fx * u[k] + skew * v[k], fy * v[k]
                block[k * LANES + filled] = -(gx[j, i] * across + gy[j, i] * down)
                block[_FLOWS + k * LANES + filled] = across
                block[_FLOWS + (PARAMETERS + k) * LANES + filled] = down
            block[PARAMETERS * LANES + filled] = base[j, i]
            block[(PARAMETERS + 1) * LANES + filled] = cover[j, i]
            block[_UNKNOWNS * LANES + filled] = residual[j, i]
            block[_WEIGHTS + filled] = weight[j, i] / (1.0 + (residual[j, i] / spread) ** 2)
            block[_WEIGHTS + LANES + filled] = weight[j, i]
            filled += 1
            if filled == LANES:
                _add_products(block, sums)
                filled = 0
        block[_WEIGHTS + filled : _WEIGHTS + LANES] = np.float32(0.0)
        block[_WEIGHTS + LANES + filled : _BLOCK] = np.float32(0.0)
        _add_products(block, sums)
        for k in range(_SUMS):
            rows[j, k] = 0.0
            for lane in range(LANES):
                rows[j, k] += sums[k * LANES + lane]


def refine_level(
    model: GaussianModel,
    picture: Float32,
    camera: Camera,
    iterations: int,
    tolerance: float,
    drawing: Drawing = Drawing(),
    *,
    free: int = CENTERED,
    max_error: float = np.inf,
) -> Refined | None:
    """Refine a camera, right within a few pixels, on one level of resolution; None where too little of the model is in
    the picture.

    `picture` (H, W) is its brightness, 0..1, at the camera's size. It takes `iterations` renders at most and stops when
    the motion's root mean square flow is below `tolerance` pixels. `drawing` tells how renders are made; so many
    parameters of the motion are `free`, by default all but the principal point and the shape of the pixels. A camera
    known to be off by at most `max_error` pixels is spared the wider blurs.
    """
    gain, offset, step, width = 1.0, 0.0, max_error, 2.0 * min(max_error, _CONFIG.widest_blur)
    memory = Acceleration()
    for iteration in range(iterations):
        image, alpha, depth = render_depth(model, camera, settings=drawing.settings)
        if drawing.blur is not None:
            image, alpha = drawing.blur.apply(image), drawing.blur.apply(alpha)
        width = min(max(step, 0.5 * width, _CONFIG.blur), _CONFIG.widest_blur)
        behind = _behind(picture, alpha, step)
        seen, base = smooth(picture - (1.0 - alpha) * behind, width), smooth(luma(image), width)
        cover = smooth(alpha, width)
        weight = _weights(alpha, depth, picture)
        used = weight > 0
        if used.sum() < _CONFIG.least_pixels:
            return None
        unit = float(np.median(depth[used]))
        if iteration == 0:
            gain, offset = robust_line(base[used], seen[used])
        toned = np.float32(gain) * base + np.float32(offset) * cover
        residual = seen - toned
        spread = robust_scale(residual[used])
        outlying = 2.5 * spread if width == _CONFIG.blur else max(2.5 * spread, _CONFIG.trusted)
        # The background stands still when the camera moves; what covers it moves.
        gy, gx = np.gradient(toned)
        by, bx = np.gradient(cover)
        gy, gx = gy - by * behind, gx - bx * behind
        rows = np.empty((camera.height, _SUMS))
        _normal_equations(
            base,
            cover,
            residual,
            np.ascontiguousarray(gx),
            np.ascontiguousarray(gy),
            np.where(used, depth / np.float32(unit), np.float32(1.0)),
            weight,
            camera.K,
            outlying,
            np.empty((thread_count(), _BLOCK + _SUMS * LANES), dtype=np.float32),
            rows,
        )
        system, flow = _triangles(rows.sum(axis=0))
        damping = max(_CONFIG.damping, _CONFIG.first_damping * 0.5**iteration if free > CENTERED else 0.0)
        motion, brightness = _solve(system, free, damping)
        flow = _symmetric(flow) / max(float(weight.sum()), 1e-12)
        step = float(np.sqrt(max(float(motion @ flow @ motion), 0.0)))
        if not np.isfinite(step) or step > 0.25 * max(camera.width, camera.height):
            return None
        move = memory.improve(motion, flow, step) if width == _CONFIG.blur else motion
        if not np.abs(move).max() < _CONFIG.farthest:
            return None  # a picture of something else: motions that hardly show run away
        camera = moved(camera, move, unit)
        gain, offset = gain + brightness[0], offset + brightness[1]
        if step < tolerance and width == _CONFIG.blur:
            break
    freed = _solve(system, PARAMETERS, _CONFIG.damping)[0]
    shift = float(np.sqrt(max(float(freed @ flow @ freed), 0.0)))
    clear = uncovered(residual, used, spread)
    detail = compare_detail(toned, seen, cover, clear, camera)
    return Refined(
        camera=camera,
        rms=spread,
        correlation=correlation(toned[used], seen[used]),
        uncovered_correlation=correlation(toned[clear], seen[clear]),
        detail=detail.correlation,
        detail_z=detail.z,
        step=step,
        shift=shift,
        pixels=int(used.sum()),
    )


class Acceleration:
    """Anderson's acceleration of a fixed-point iteration (Walker and Ni 2011).

    The columns come from flow and gradients and so carry errors, which shrink the steps along directions that
    hardly show, such as a longer lens further away: there plain Gauss-Newton goes a tenth of the way each time.
    What the last steps achieved tells how much further to go.
    """

    def __init__(self) -> None:
        self._motions: list[Float64] = []
        self._moves: list[Float64] = []

    def improve(self, motion: Float64, flow: Float64, step: float) -> Float64:
        """The move to make in place of a motion (9,), whose squared flow is motion' flow motion = step^2."""
        if step > _CONFIG.accelerated:  # not linear yet
            self._motions, self._moves = [], []
            return motion
        move = motion
        if self._moves:
            changes = np.diff(np.stack([*self._motions, motion]), axis=0).T  # (9, m)
            moves = np.stack(self._moves).T  # (9, m)
            normal = changes.T @ flow @ changes
            normal[np.diag_indices_from(normal)] *= 1.0 + 1e-6
            normal[np.diag_indices_from(normal)] += 1e-16
            mix = np.linalg.solve(normal, changes.T @ flow @ motion)
            if np.abs(mix).max() < _CONFIG.most_extrapolation:
                move = motion - (moves + changes) @ mix
        self._motions = [*self._motions, motion][-_CONFIG.memory :]
        self._moves = [*self._moves, move][-_CONFIG.memory :]
        return move


def _behind(picture: Float32, alpha: Float32, step: float) -> Float32:
    """(H, W) what lies behind the model; nothing where it cannot be seen."""
    margin = int(np.clip(2.0 * step, ALIGNMENT.background.margin, _CONFIG.far_margin))
    filled = fill_background(picture, alpha, margin)
    return np.zeros_like(picture) if filled is None else filled


def _weights(alpha: Float32, depth: Float32, seen: Float32) -> Float32:
    """(H, W) how far a pixel shows the model and nothing else."""
    usable = (alpha > _CONFIG.least_alpha) & (depth > 0) & (seen < _CONFIG.clipped)
    return np.asarray(usable * np.square(np.square(alpha)), dtype=np.float32)


def _triangles(sums: Float64) -> tuple[Float64, Float64]:
    """The upper triangles of what `_normal_equations` adds up: columns by columns and residual, flows by flows."""
    system, flow = np.zeros((_UNKNOWNS, _UNKNOWNS + 1)), np.zeros((PARAMETERS, PARAMETERS))
    system[np.triu_indices(_UNKNOWNS, m=_UNKNOWNS + 1)] = sums[:_PRODUCTS]
    flow[np.triu_indices(PARAMETERS)] = sums[_PRODUCTS:]
    return system, flow


def _symmetric(upper: Float64) -> Float64:
    return np.asarray(upper + np.triu(upper, 1).T)


def _solve(system: Float64, free: int, damping: float) -> tuple[Float64, Float64]:
    """Motion (11,), zero beyond so many parameters, and change of gain and offset (2,) from the summed upper triangle
    and right side."""
    unknowns = np.r_[:free, PARAMETERS:_UNKNOWNS]
    normal = _symmetric(system[:, :_UNKNOWNS])[np.ix_(unknowns, unknowns)]
    scale = 1.0 / np.sqrt(np.maximum(np.diagonal(normal), 1e-12))
    # Distance and focal length are nearly one number in a view from afar: the damping keeps what the picture
    # cannot tell where it was.
    damped = normal * scale[:, None] * scale + damping * np.eye(len(unknowns))
    solution = np.zeros(_UNKNOWNS)
    solution[unknowns] = scale * np.linalg.solve(damped, scale * system[unknowns, _UNKNOWNS])
    return solution[:PARAMETERS], solution[PARAMETERS:]
