"""Colors of a model that were changed before it was rendered, to wash the mark out: averaged, or denoised.

What washing does to the *reference* is known: most of what a picture of a washed model is off by follows from the
reference alone. So the reference is washed alike, the picture is held against that, and what is left is the mark, as
far as the washing left it.

1. A first look: do averages over runs of neighbors explain a part of what the picture is off by? Of most pictures they
   explain nothing.
2. *Averaging*: the colors of the reference are averaged over 8 neighbors again and again: after 1, 4 and 16 rounds,
   which come to about 8, 32 and 128 neighbors. The picture is regressed on the renders of these. The shares are those
   of one linear map of the colors, near enough to whatever average was taken.
3. *Cells*: means of cells in place and color. Where the borders lay is not known; on average over all borders, a color
   became the mean of those that are near in both. So the picture is regressed on renders of such means.
4. *Denoising*: what a color is not explained by its neighborhood's (`misfit`, from the public cells) is taken off, up
   to some limit. The picture is regressed on renders of the misfit of the reference, limited at several sizes. How a
   small displacement comes through follows from the slope of that curve.
5. What explains the picture better counts, if it is clearly better than the reference.

Nothing here sees a key or a chip.
"""

from __future__ import annotations  # those that name SciPy's modules would load them

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import scipy

from engine.formats.morton import morton_order
from engine.model import SH_C0, Bool, Float32, Float64, Int64
from engine.pictures.alignment.config import CONFIG
from engine.raster import View

_CONFIG = CONFIG.color_change


class Neighborhoods:
    """Averages of a model's colors over more and more neighbors.

    Parameters
    ----------
    means : (N, 3) float32
        Centers of its Gaussians.
    """

    def __init__(self, means: Float32) -> None:
        self._means = means

    @cached_property
    def _average(self) -> scipy.sparse.csr_array:
        """(N, N) the mean over the nearest, itself among them."""
        count, nearest = len(self._means), min(_CONFIG.neighbors, len(self._means))
        near = scipy.spatial.cKDTree(self._means).query(self._means, k=nearest, workers=2)[1]
        return _mean_over(near.reshape(count, nearest))

    def averaged(self, values: Float32) -> Iterator[Float32]:
        """Values of each Gaussian (N, C) as they are, and averaged ever more often."""
        yield from _rounds(self._average, values)

    @cached_property
    def _runs(self) -> Int64:
        """(N,) the run of near Gaussians that each is in."""
        runs = np.empty(len(self._means), dtype=np.int64)
        runs[morton_order(self._means)] = np.arange(len(runs)) // _CONFIG.run
        return runs

    def runs(self, values: Float32) -> Float32:
        """Values (N, 3), each the mean of a run of near ones along a curve: a rough average that costs little."""
        count = np.bincount(self._runs)
        sums = [np.bincount(self._runs, column) / count for column in values.T]
        return np.stack(sums, axis=1)[self._runs].astype(np.float32)

    def adjoint(self, values: Float32) -> Iterator[Float32]:
        """The transposes of the averages."""
        yield from _rounds(self._average.T.tocsr(), values)


class Alike:
    """Averages of colors over Gaussians that are near in place and color, as those of a cell are.

    Parameters
    ----------
    means : (N, 3) float32
        Centers of the reference's Gaussians.
    colors : (N, 3) float32
        Their DC coefficients.
    """

    def __init__(self, means: Float32, colors: Float32) -> None:
        self._means, self._colors = means, colors

    @cached_property
    def _averages(self) -> list[scipy.sparse.csr_array]:
        """(N, N) the means over the fewest, and over more; over the most among a part of them, which costs less."""
        tree, most = scipy.spatial.cKDTree(self._means), min(_CONFIG.alike[-1], len(self._means))
        few = morton_order(self._means)[:: _CONFIG.thinned]
        some = self._means[few[:: _CONFIG.thinned]]
        reach = float(np.median(tree.query(some, k=[min(_CONFIG.reach, len(self._means))], workers=2)[0]))
        places = np.concatenate([self._means / max(reach, float(np.finfo(np.float32).tiny)), self._colors], axis=1)
        near = scipy.spatial.cKDTree(places).query(places, k=range(1, most + 1), workers=2)[1]
        wide = scipy.spatial.cKDTree(places[few]).query(places, k=range(1, min(most, len(few)) + 1), workers=2)[1]
        return [*(_mean_over(near[:, :size]) for size in _CONFIG.alike), _mean_over(few[wide])]

    def averaged(self, values: Float32) -> Iterator[Float32]:
        """Values of each Gaussian (N, C) as they are, and averaged ever more widely."""
        yield values
        yield from (average @ values for average in self._averages)

    def adjoint(self, values: Float32) -> Iterator[Float32]:
        """The transposes of the averages."""
        yield values
        yield from (average.T @ values for average in self._averages)


def _mean_over(near: Int64) -> scipy.sparse.csr_array:
    """(N, N) the mean over the Gaussians near each (N, K)."""
    count, each = near.shape
    shares = np.full(near.size, 1.0 / each, dtype=np.float32)
    rows = np.arange(0, near.size + 1, each)
    return scipy.sparse.csr_array((shares, near.reshape(-1), rows), shape=(count, count))


def _rounds(average: scipy.sparse.csr_array, values: Float32) -> Iterator[Float32]:
    yield values
    for number in range(1, _CONFIG.rounds[-1] + 1):
        values = average @ values
        if number in _CONFIG.rounds:
            yield values


@dataclass(frozen=True, eq=False)
class ColorSmoothing:
    """What became of a model's colors: a sum of their averages."""

    neighborhoods: Neighborhoods | Alike
    shares: Float64  # (K,) of the colors as they were, and of each average; sum 1

    def apply(self, colors: Float32) -> Float32:
        """Colors (N, C), or displacements of them, smoothed."""
        return self._sum(self.neighborhoods.averaged(colors))

    def adjoint(self, cotangent: Float32) -> Float32:
        """A cotangent of the smoothed colors (N, C), pulled back to the sharp ones."""
        return self._sum(self.neighborhoods.adjoint(cotangent))

    def _sum(self, averages: Iterator[Float32]) -> Float32:
        shares = self.shares.astype(np.float32)
        return np.asarray(sum(share * each for share, each in zip(shares, averages, strict=True)), dtype=np.float32)

    def shown(self, colors: Float32) -> Float32:
        """The reference's colors (N, 3), smoothed."""
        return self.apply(colors)

    @property
    def kept(self) -> float:
        """Share of each color that is its own."""
        return float(self.shares[0])


@dataclass(frozen=True, eq=False)
class Misfit:
    """What the reference's colors are not explained by their neighborhoods'."""

    values: Float32  # (N, 3) DC
    size: float  # of a mark's displacements, DC: limits are counted in it

    def limited(self, limit: float) -> Float32:
        """(N, 3) no more than so many times the mark's size, softly."""
        most = np.float32(limit * self.size)
        return np.asarray(most * np.tanh(self.values / most))

    def slope(self, limit: float) -> Float32:
        """(N, 3) of `limited`."""
        return np.asarray(1.0 - np.square(np.tanh(self.values / np.float32(limit * self.size))))


@dataclass(frozen=True, eq=False)
class Denoising:
    """What became of a model's colors: some curve of their misfit was added to them."""

    misfit: Misfit
    times: Float64  # (L,) of the misfit limited at each size
    neighborhoods: Neighborhoods

    def shown(self, colors: Float32) -> Float32:
        """The reference's colors (N, 3), denoised."""
        return np.asarray(colors + self._sum(self.misfit.limited), dtype=np.float32)

    def apply(self, displacements: Float32) -> Float32:
        """Small displacements of its colors (N, 3), as they come through: the misfit changes by what they are off from
        the widest average."""
        *_, around = self.neighborhoods.averaged(displacements)
        return np.asarray(displacements + self._sum(self.misfit.slope) * (displacements - around), dtype=np.float32)

    def adjoint(self, cotangent: Float32) -> Float32:
        """A cotangent of the denoised colors (N, 3), pulled back."""
        through = self._sum(self.misfit.slope) * cotangent
        *_, around = self.neighborhoods.adjoint(through)
        return np.asarray(cotangent + through - around, dtype=np.float32)

    @property
    def kept(self) -> float:
        """What is left of a small displacement of one color by itself, in the median."""
        return 1.0 + float(np.median(self._sum(self.misfit.slope)))

    def _sum(self, part: Callable[[float], Float32]) -> Float32:
        parts = (np.float32(times) * part(limit) for times, limit in zip(self.times, _CONFIG.limits, strict=True))
        return np.asarray(sum(parts), dtype=np.float32)


ColorChange = ColorSmoothing | Denoising


def find_color_change(
    neighborhoods: Neighborhoods,
    alike: Alike,
    misfit: Callable[[], Misfit],
    colors: Float32,
    view: View,
    plain: Float32,
    picture: Float32,
    usable: Bool,
) -> ColorChange | None:
    """How the colors of the model that a picture shows were changed; None where they were not.

    Parameters
    ----------
    neighborhoods : Neighborhoods
        Of the reference.
    alike : Alike
        Of the reference.
    misfit : callable
        Of its colors; called where the first look shows something.
    colors : (N, 3) float32
        Its DC coefficients.
    view : View
        The reference's geometry at the picture's camera.
    plain : (H, W, 3) float32
        Its render, 0..1.
    picture : (H, W, 3) float32
        The picture in the same pixels, 0..1.
    usable : (H, W) bool
        Pixels that show the model alone.
    """
    bright = (plain.max(axis=2) < _CONFIG.clipped) & (picture.max(axis=2) < _CONFIG.clipped)
    where = np.flatnonzero(usable & bright)
    if len(where) < _CONFIG.least_samples or len(colors) > _CONFIG.most_gaussians:
        return None
    where = where[:: max(1, len(where) // _CONFIG.samples)]
    base, seen = (image.reshape(-1, 3)[where] for image in (plain, picture))

    def shown(change: Float32) -> Float32:
        """(P, 3) what a change of the colors changes in the render."""
        image, _ = view.render(np.ascontiguousarray(np.float32(SH_C0) * change))
        return image.reshape(-1, 3)[where]

    if _fit([shown(neighborhoods.runs(colors) - colors)], base, seen)[1] < _CONFIG.looks:
        return None

    def smooth(over: Neighborhoods | Alike) -> tuple[ColorSmoothing, float]:
        _, *averages = over.averaged(colors)
        shares, explained = _fit([shown(each - colors) for each in averages], base, seen)
        return ColorSmoothing(over, np.concatenate([[1.0 - shares.sum()], shares])), explained

    smoothing, smoothed = smooth(neighborhoods)
    if smoothed > _CONFIG.surely:
        return smoothing
    if len(colors) <= _CONFIG.most_alike:
        cells, told = smooth(alike)
        if told > smoothed + _CONFIG.clearly:
            smoothing, smoothed = cells, told
    rest = misfit()
    times, denoised = _fit([shown(rest.limited(limit)) for limit in _CONFIG.limits], base, seen)
    denoising = Denoising(rest, times, neighborhoods)
    if denoised > max(smoothed, _CONFIG.explained) and denoising.kept > _CONFIG.least_kept:
        return denoising
    return smoothing if smoothed > _CONFIG.explained else None


def _fit(columns: Sequence[Float32], base: Float32, seen: Float32) -> tuple[Float64, float]:
    """Shares (K,) of the columns (P, 3) in what a picture `seen` (P, 3) is off by from `base` (P, 3); and what part of
    its squares they explain that no curve of each channel does."""
    count, residual = len(columns), (seen - base).astype(np.float64)
    design = np.zeros((*residual.shape, count + 9))
    design[..., :count] = np.stack(columns, axis=-1)
    for channel in range(3):
        for power in range(3):
            design[:, channel, count + 3 * channel + power] = base[:, channel] ** power
    design, target = design.reshape(-1, count + 9), residual.reshape(-1)
    weight = np.ones(len(target))
    for _ in range(_CONFIG.fits):
        weighted = design * weight[:, None]
        normal, right = weighted.T @ design, weighted.T @ target
        normal[np.diag_indices(len(normal))] += _CONFIG.ridge * np.trace(normal)
        solution = np.linalg.solve(normal, right)
        left = target - design @ solution
        limit = _CONFIG.outlying * float(np.sqrt(np.square(left).mean())) + np.finfo(np.float32).tiny
        weight = 1.0 / (1.0 + np.square(left / limit))
    curves = np.linalg.solve(normal[count:, count:], right[count:])
    before = float(weight @ np.square(target - design[:, count:] @ curves))
    after = float(weight @ np.square(left))
    return np.asarray(solution[:count], dtype=np.float64), 1.0 - after / before if before > 0 else 0.0
