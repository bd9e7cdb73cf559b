"""Where a cloud of colored points lies in the reference: nothing but places and colors is there to be compared.

Points of like color have a common middle, which a similarity moves along and thinning leaves where it was: the middles
of some classes of color are pairs of points. What they say is refined by the nearest points of like color.
"""

import numpy as np
import numpy.typing as npt

from engine.model import SH_C0, Float64, GaussianModel
from engine.numerics.similarity import MIRROR
from engine.numerics.umeyama import Similarity, fit_noisy_source, umeyama
from engine.registration.config import CONFIG

_CONFIG = CONFIG.points

Pairs = tuple[npt.NDArray[np.int64], npt.NDArray[np.int64]]


def are_points(model: GaussianModel) -> bool:
    """Whether all Gaussians have one size and one opacity, so that these say nothing."""
    return len(model) > 0 and all(
        bool((values == values.flat[0]).all()) for values in (model.log_scales, model.opacity_logits)
    )


def place_points(
    reference: GaussianModel, suspect: GaussianModel, mirrored: bool, rng: np.random.Generator
) -> tuple[Similarity, Pairs] | None:
    """The similarity that takes the points, or their mirror image, to the reference, and pairs that it makes (reference
    and suspect row); None where no three classes of color are in both."""
    from scipy.spatial import cKDTree  # slow to load, and few suspects are points

    theirs = suspect.means.astype(np.float64) * (MIRROR if mirrored else 1.0)
    own, dc, seen = reference.means.astype(np.float64), _colors(reference), _colors(suspect)
    fit = _by_classes(own, dc, theirs, seen)
    if fit is None:
        return None
    reach = float(np.median(np.linalg.norm(own - np.median(own, axis=0), axis=1)))
    rows = rng.permutation(len(theirs))[: _CONFIG.sample]
    for width in _CONFIG.first * reach * _CONFIG.narrower ** np.arange(_CONFIG.rounds):
        weight = _CONFIG.color_weight * width
        tree = cKDTree(np.hstack([own, weight * dc]))
        apart, near = tree.query(np.hstack([fit.apply(theirs[rows]), weight * seen[rows]]), distance_upper_bound=width)
        good = np.isfinite(apart)
        if np.count_nonzero(good) < _CONFIG.least:
            return None
        fit = fit_noisy_source(theirs[rows[good]], own[near[good]], start=fit)
        if fit is None:
            return None
    return fit, (near[good].astype(np.int64), rows[good].astype(np.int64))


def _colors(model: GaussianModel) -> Float64:
    """(N, 3) colors as a file of 8 bits holds them, 0 to 1."""
    return np.clip(0.5 + SH_C0 * model.sh[:, 0].astype(np.float64), 0.0, 1.0)


def _by_classes(own: Float64, dc: Float64, theirs: Float64, seen: Float64) -> Similarity | None:
    """The similarity of the middles of classes of color, which are cells between quantiles of the reference's."""
    edges = np.quantile(dc, np.arange(1, _CONFIG.steps) / _CONFIG.steps, axis=0)
    middles, weights = [], []
    homes = [
        sum(np.searchsorted(edges[:, c], colors[:, c]) * _CONFIG.steps**c for c in range(3)) for colors in (dc, seen)
    ]
    for cell in range(_CONFIG.steps**3):
        mine, other = (np.flatnonzero(home == cell) for home in homes)
        if min(len(mine), len(other)) >= _CONFIG.least:
            middles.append((np.median(theirs[other], axis=0), np.median(own[mine], axis=0)))
            weights.append(min(len(mine) / len(own), len(other) / len(theirs)))
    if len(middles) < 4:
        return None
    source, target = (np.array(each) for each in zip(*middles, strict=True))
    return umeyama(source, target, np.array(weights))
