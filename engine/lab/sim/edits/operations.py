"""Local edits of a model: every one takes a model and a selection and gives the edited model and its `Edit`.

A selection (N,) bool that is empty or unfit, and numbers out of their range, are an InputError. Covariances and
spherical harmonics turn with their Gaussians (quaternion product, Wigner-D), so a piece looks in its new place as it
did in the old one. The model that was given is left as it is.
"""

import numpy as np
import numpy.typing as npt
from scipy.spatial.transform import Rotation

from engine.errors import InputError
from engine.lab.sim.attack import check_positive
from engine.lab.sim.edits.edit import Action, Edit, Edited, Recoloring
from engine.lab.sim.edits.selection import check_selection
from engine.lab.sim.vectors import check_triple
from engine.model import Bool, Float64, GaussianModel
from engine.numerics.umeyama import Similarity

__all__ = ["delete", "duplicate", "move", "place", "recolor", "recolor_towards", "rotate", "scale"]


def move(model: GaussianModel, selection: Bool, shift: npt.ArrayLike) -> Edited:
    """Shift the selected Gaussians by (3,) scene units."""
    return _edit("move", model, selection, Similarity(1.0, np.eye(3), check_triple(shift, "shift")))


def rotate(
    model: GaussianModel, selection: Bool, axis: npt.ArrayLike, degrees: float, about: npt.ArrayLike | None = None
) -> Edited:
    """Turn the selected Gaussians, right-handed, about an axis (3,) of any length but 0.

    The point `about` stays where it is; the middle of the selection's bounding box by default.
    """
    direction = check_triple(axis, "axis")
    length = float(np.linalg.norm(direction))
    if length == 0:
        raise InputError("the axis of a rotation must not be zero")
    if not np.isfinite(degrees):
        raise InputError(f"angle must be finite, got {degrees}")
    R = Rotation.from_rotvec(np.radians(degrees) * direction / length).as_matrix()
    return _edit("rotate", model, selection, _about(model, selection, 1.0, R, about))


def scale(model: GaussianModel, selection: Bool, factor: float, about: npt.ArrayLike | None = None) -> Edited:
    """Scale the selected Gaussians by `factor` > 0 about a point (the middle of their box by default)."""
    check_positive(factor, "scale factor")
    return _edit("scale", model, selection, _about(model, selection, factor, np.eye(3), about))


def place(model: GaussianModel, selection: Bool, similarity: Similarity) -> Edited:
    """Move, turn and scale the selected Gaussians at once: x_new = scale * R @ x + t."""
    return _edit("place", model, selection, similarity)


def recolor(model: GaussianModel, selection: Bool, *, gain: npt.ArrayLike = 1.0, tint: npt.ArrayLike = 0.0) -> Edited:
    """Multiply the colours of the selected Gaussians by `gain` >= 0, then add `tint`; each scalar or (3,)."""
    change = Recoloring(_channels(gain, "gain"), _channels(tint, "tint"))
    if (change.gain < 0).any():
        raise InputError(f"gain must not be negative, got {change.gain.tolist()}")
    return _edit("recolor", model, selection, recoloring=change)


def recolor_towards(model: GaussianModel, selection: Bool, color: npt.ArrayLike, strength: float = 1.0) -> Edited:
    """Paint the selected Gaussians: colour = (1 - strength) * colour + strength * target, scalar or (3,), 0 to 1.

    At strength 1 the target is all that is left, and nothing of a mark.
    """
    if not 0 <= strength <= 1:
        raise InputError(f"strength of a recolouring must lie in [0, 1], got {strength}")
    change = Recoloring(np.full(3, 1.0 - strength), strength * _channels(color, "color"))
    return _edit("recolor", model, selection, recoloring=change)


def delete(model: GaussianModel, selection: Bool) -> Edited:
    """Remove the selected Gaussians; the hole stays (`inpaint` fills it)."""
    rows = check_selection(model, selection)
    if len(rows) == len(model):
        raise InputError(f"deleting all {len(model)} Gaussians would leave no model")
    return _edit("delete", model, selection)


def duplicate(model: GaussianModel, selection: Bool, similarity: Similarity) -> Edited:
    """Append copies of the selected Gaussians, placed by x_new = scale * R @ x + t."""
    return _edit("duplicate", model, selection, similarity)


def _edit(
    name: str,
    model: GaussianModel,
    selection: Bool,
    similarity: Similarity | None = None,
    recoloring: Recoloring | None = None,
) -> Edited:
    """Carry out an edit that is a deletion, a duplication, or else a change."""
    rows = check_selection(model, selection)
    action: Action = "delete" if name == "delete" else "duplicate" if name == "duplicate" else "change"
    similarity, recoloring = similarity or Similarity.identity(), recoloring or Recoloring.none()
    edit = Edit(name, action, len(model), rows, model.take(rows), similarity, recoloring)
    return Edited(edit.apply(model), edit)


def _about(model: GaussianModel, selection: Bool, factor: float, R: Float64, about: npt.ArrayLike | None) -> Similarity:
    """The similarity of that factor and rotation that leaves a point where it is."""
    if about is None:
        means = model.means[check_selection(model, selection)].astype(np.float64)
        pivot = 0.5 * (means.min(axis=0) + means.max(axis=0))
    else:
        pivot = check_triple(about, "about")
    return Similarity(factor, R, pivot - factor * R @ pivot)


def _channels(value: npt.ArrayLike, what: str) -> Float64:
    array = np.asarray(value, dtype=np.float64)
    if array.shape not in ((), (3,)) or not np.isfinite(array).all():
        raise InputError(f"{what} must be one finite number or three, got {value!r}")
    return np.broadcast_to(array, (3,)).copy()
