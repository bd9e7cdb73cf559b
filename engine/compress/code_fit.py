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
from engine.model import Bool, Float32, Float64, GaussianModel
from engine.raster import prepare_view

_CONFIG = CONFIG.code_fit


def fit_codes(model: GaussianModel, stages: tuple[Stage, ...], target: Target, tell: Tell) -> tuple[Stage, ...]:
    """The stages with code vectors of which the model's geometry renders nearer to the target, by squared error.

    Its own colors are not looked at. Stops when a step gains next to nothing; the same bits whatever the number of
    threads. `tell` gets the PSNR over all the target's views, but for colors that come to be clamped or cease to be.
    """
    renders = _Renders(model, stages, target)
    books = np.concatenate([stage.codebook for stage in stages], dtype=np.float64)  # (M, 3K) of all stages
    residual, weights, error = renders.start(books)
    direction, slope = np.zeros_like(books), 1.0
    samples = 3 * sum(camera.width * camera.height for camera in target.cameras)
    for step in range(_CONFIG.steps):
        scaled = residual / weights
        before, slope = slope, float((residual * scaled).sum())
        direction = scaled + slope / before * direction
        image = renders.normal(direction)
        length = slope / max(float((direction * image).sum()), 1e-300)
        books += length * direction
        residual -= length * image
        gain, error = length * slope / max(error, 1e-300), error - length * slope
        tell((step + 1) / _CONFIG.steps, float(-10.0 * np.log10(max(error, 1e-300) / samples)))
        if gain < _CONFIG.least_gain:
            break
    each = np.split(books.astype(np.float32), np.cumsum([len(stage.codebook) for stage in stages])[:-1])
    return tuple(replace(stage, codebook=book) for stage, book in zip(stages, each, strict=True))


def fit_colors(model: GaussianModel, target: Target, tell: Tell) -> GaussianModel:
    """The model with colors of its own fitted: a code for each Gaussian."""
    own = Stage(model.sh.reshape(len(model), -1), np.arange(len(model), dtype=np.int32))
    return model.with_(sh=decode_stages(fit_codes(model, (own,), target, tell)))


class _Renders:
    """Renders of the target's views as a linear map A of the code vectors, and its transpose."""

    def __init__(self, model: GaussianModel, stages: tuple[Stage, ...], target: Target) -> None:
        self._model, self._target = model, target
        self._count = sum(len(stage.codebook) for stage in stages)
        firsts = np.cumsum([0, *(len(stage.codebook) for stage in stages[:-1])])
        self._labels = [stage.labels + np.int32(first) for stage, first in zip(stages, firsts, strict=True)]
        self._lit: list[Bool] = []  # (N, 3) of each view: colors that are not clamped at 0

    def start(self, books: Float64) -> tuple[Float64, Float64, float]:
        """A^T of what the code vectors miss, (M, 1) the diagonal of A^T A but for the basis, and the squared error."""
        model, target, sh, error = self._model, self._target, self._decode(books), 0.0
        total, squares = np.zeros_like(sh), np.full((len(model), 1), np.float32(_CONFIG.prior))
        for camera, wanted in zip(target.cameras, target.images, strict=True):
            view, basis = prepare_view(model, camera), seen_harmonics(model, camera, model.sh_degree)
            colors = np.einsum("nk,nkc->nc", basis, sh) + np.float32(0.5)
            self._lit.append(colors > 0.0)
            gap = wanted.astype(np.float32) - np.clip(view.render(np.maximum(colors, np.float32(0.0)))[0], 0.0, 1.0)
            error += float(np.square(gap, dtype=np.float64).sum())
            squares[:, 0] += view.weights()[1]
            total += basis[:, :, None] * (view.backward_colors(gap) * self._lit[-1])[:, None]
        return self._gather(total), self._gather(squares), error

    def normal(self, books: Float64) -> Float64:
        """A^T A of code vectors. A prior holds what hardly any pixel shows where it was."""
        model, sh = self._model, self._decode(books)
        total = np.float32(_CONFIG.prior) * sh
        for camera, lit in zip(self._target.cameras, self._lit, strict=True):
            view, basis = prepare_view(model, camera), seen_harmonics(model, camera, model.sh_degree)
            image = view.render(np.einsum("nk,nkc->nc", basis, sh) * lit)[0]
            total += basis[:, :, None] * (view.backward_colors(image) * lit)[:, None]
        return self._gather(total)

    def _decode(self, books: Float64) -> Float32:
        """(N, K, 3) the sum of each Gaussian's codes."""
        narrow = books.astype(np.float32)
        return np.asarray(sum(narrow[labels] for labels in self._labels)).reshape(self._model.sh.shape)

    def _gather(self, values: Float32) -> Float64:
        """(M, d) sums over each code's Gaussians."""
        rows = values.reshape(len(values), -1)
        sums, ones = np.zeros((self._count, rows.shape[1])), np.ones(len(rows))
        for labels in self._labels:
            add_up(rows, labels, ones, sums)
        return sums
