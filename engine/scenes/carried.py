"""Which of a file's further properties may stand beside a mark: not those that tell what a marked value was before.

An unmarked copy of a color beside the marked one gives the original back; so does whatever follows from it, such as a
brightness, a hue, a palette's index. A property is left out where its name says so, or where Gaussians that are alike
in color (or in sizes and opacity; or, of more than `MOST_LABELS` values, in place) are alike in it, too. What was
scrambled on purpose is not noticed.
"""

import re

import numpy as np
import numpy.typing as npt

from engine.formats.ply.extras import named
from engine.model import Carried, Float32, GaussianModel

__all__ = ["left_out_note", "revealing", "without"]

_NAMES = re.compile(
    r"(.*_)?(f_(dc|rest)|red|green|blue|r|g|b|alpha|rgba?|colou?rs?|albedo|diffuse|base|sh|hue|hsv|lab|luma|luminance"
    r"|grey|gray|intensity|opacity|scales?|scaling|rot|rotation|quat|xyz|x|y|z|pos|position|means?|center|orig(inal)?)"
    r"(_?\w?\d*)?",
    re.IGNORECASE,
)
MOST_LABELS = 256
"""Values of what may be a label of things: those follow from the place, and tell it no finer than a thing is large."""
ALIKE = 1 / 4
"""Of the usual difference between two Gaussians: neighbors' least one that shows no dependence."""
_SAMPLE = 4096


def _most_alike(attributes: Float32) -> npt.NDArray[np.intp]:
    """(S,) which other Gaussian is most like each in these attributes (S, D)."""
    from scipy.spatial import cKDTree  # slow to load, and few files carry anything

    white = attributes.astype(np.float64) / np.maximum(attributes.std(axis=0), 1e-12)
    first, second = cKDTree(white).query(white, k=2)[1].T
    return np.asarray(np.where(first == np.arange(len(white)), second, first))


def revealing(model: GaussianModel) -> list[str]:
    """Names of what the model carries that must not stand beside a mark."""
    carried = model.carried
    if carried is None or not carried.names:
        return []
    rng = np.random.default_rng(0)
    rows = np.sort(rng.choice(len(model), min(_SAMPLE, len(model)), replace=False))
    shuffled = rng.permutation(len(rows))
    part = model.take(rows)
    looks = [part.sh[:, 0], np.column_stack([part.log_scales, part.opacity_logits]), part.means]
    color, size, place = map(_most_alike, looks)
    found = []
    for name in carried.names:
        # Ranks have no unit, and no stray counts for more than one.
        ranks = np.unique(carried.columns[name][rows], return_inverse=True)[1].astype(np.float64)
        usual = np.abs(ranks - ranks[shuffled]).mean()
        asked = (color, size, place) if ranks.max() >= MOST_LABELS else (color, size)
        follows = any(np.abs(ranks - ranks[alike]).mean() < ALIKE * usual for alike in asked)
        if _NAMES.fullmatch(name) or follows:
            found.append(name)
    return found


def without(model: GaussianModel, names: list[str]) -> GaussianModel:
    """The model, carrying all but these."""
    if model.carried is None or not names:
        return model
    kept = [name for name in model.carried.names if name not in names]
    columns = np.empty(len(model), [(name, model.carried.columns.dtype[name]) for name in kept])
    for name in kept:
        columns[name] = model.carried.columns[name]
    return model.with_(carried=Carried(columns, model.carried.comments))


def left_out_note(names: list[str]) -> list[str]:
    """The note on what `without` left out."""
    if not names:
        return []
    count = f"{len(names)} {'property' if len(names) == 1 else 'properties'}"
    return [f"left out, because it tells what marked values were before: {count} ({named(names)})"]
