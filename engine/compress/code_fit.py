"""Code vectors fitted to the original's renders: what quantizing costs is made good where it shows (DESIGN 4.4).

A picture is linear in the colors, so the best code vectors are a least-squares problem: conjugate gradients,
preconditioned with the diagonal, each Gaussian's gradient gathered by its codes. Clamped colors stay clamped.
"""

from dataclasses import replace

import numpy as np

from engine.compress.config import CONFIG
from engine.compress.hvq import Stage, add_up, decode_stages
from engine.compress.impact import seen_harmonics
from engine.compress.recovery import Target, Tell
from engine.model import Float32, Float64, GaussianModel
from engine.raster import prepare_view

_CONFIG = CONFIG.code_fit


def fit_codes(model: GaussianModel, stages: tuple[Stage, ...], target: Target, tell: Tell) -> tuple[Stage, ...]:
    """The stages with code vectors of which the model's geometry renders nearer to the target, by squared error.

    Its own colors are not looked at. Stops when a step gains next to nothing; the same bits whatever the number of
    threads. `tell` gets a PSNR over all the target's views that is reached at least.
    """
    problem = _Renders(model, stages, target)
    books = [stage.codebook.astype(np.float64) for stage in stages]
    residual, error = problem.start(books)
    direction, slope = books, 0.0
    samples = 3 * sum(camera.width * camera.height for camera in target.cameras)
    for step in range(_CONFIG.steps):
        scaled = [r / w for r, w in zip(residual, problem.curvature, strict=True)]
        before, slope = slope, _dot(residual, scaled)
        direction = [z + (slope / before) * d for z, d in zip(scaled, direction, strict=True)] if step else scaled
        image = problem.normal(direction)
        length = slope / max(_dot(direction, image), 1e-300)
        books = [b + length * d for b, d in zip(books, direction, strict=True)]
        residual = [r - length * i for r, i in zip(residual, image, strict=True)]
        gain, error = length * slope / max(error, 1e-300), error - length * slope
        tell((step + 1) / _CONFIG.steps, float(-10.0 * np.log10(max(error, 1e-300) / samples)))
        if gain < _CONFIG.least_gain:
            break
    return tuple(replace(s, codebook=b.astype(np.float32)) for s, b in zip(stages, books, strict=True))


def fit_colors(model: GaussianModel, target: Target, tell: Tell) -> GaussianModel:
    """The model with colors of its own fitted: a code for each Gaussian."""
    own = Stage(model.sh.reshape(len(model), -1), np.arange(len(model), dtype=np.int32))
    return model.with_(sh=decode_stages(fit_codes(model, (own,), target, tell)))


def _dot(a: list[Float64], b: list[Float64]) -> float:
    return sum(float((x * y).sum()) for x, y in zip(a, b, strict=True))


class _Renders:
    """Renders of the target's views as a linear map of the code vectors, and its transpose."""

    def __init__(self, model: GaussianModel, stages: tuple[Stage, ...], target: Target) -> None:
        self._model, self._stages, self._target = model, stages, target
        self._lit = [np.zeros(0, bool)] * len(target.cameras)  # (N, 3) each: colors that are not clamped at 0
        self.curvature: list[Float64] = []  # (M, 1) of each stage: diagonal, without the basis

    def start(self, books: list[Float64]) -> tuple[list[Float64], float]:
        """Half the negative gradient of the squared error, and the error."""
        return self._walk(books, first=True)

    def normal(self, books: list[Float64]) -> list[Float64]:
        """A^T A of code vectors."""
        return self._walk(books, first=False)[0]

    def _walk(self, books: list[Float64], *, first: bool) -> tuple[list[Float64], float]:
        model, target = self._model, self._target
        codes = tuple(replace(s, codebook=b.astype(np.float32)) for s, b in zip(self._stages, books, strict=True))
        sh, error = decode_stages(codes), 0.0
        # What hardly any pixel shows stays where it was
        total = np.zeros_like(sh) if first else np.float32(_CONFIG.prior) * sh
        squares = np.full((len(model), 1), np.float32(_CONFIG.prior))
        for k, camera in enumerate(target.cameras):
            view, basis = prepare_view(model, camera), seen_harmonics(model, camera, model.sh_degree)
            colors = np.einsum("nk,nkc->nc", basis, sh)
            if first:
                colors += np.float32(0.5)
                self._lit[k] = colors > 0.0
                squares[:, 0] += view.weights()[1]
            colors *= self._lit[k]
            image = view.render(colors)[0]
            if first:
                image = target.images[k] - np.clip(image, 0.0, 1.0)
                error += float(np.square(image, dtype=np.float64).sum())
            total += basis[:, :, None] * (view.backward_colors(image) * self._lit[k])[:, None]
        if first:
            self.curvature = self._gathered(squares)
        return self._gathered(total.reshape(len(model), -1)), error

    def _gathered(self, values: Float32) -> list[Float64]:
        """Sums over each code's Gaussians, (M, d) of each stage."""
        ones, sums = np.ones(len(values)), [np.zeros((len(s.codebook), values.shape[1])) for s in self._stages]
        for stage, into in zip(self._stages, sums, strict=True):
            add_up(values, stage.labels, ones, into)
        return sums
