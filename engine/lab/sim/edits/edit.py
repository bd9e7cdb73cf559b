"""Local edits of a model, and tracks of them: C'_k = C_k + delta C_k (paper, MarkGS-Sim).

Every operation takes a model and a selection and gives the edited model and its `Edit`, a value that can be repeated
and undone. A selection (N,) bool that is empty or unfit, and numbers out of their range, are an InputError. Covariances
and spherical harmonics turn with their Gaussians (quaternion product, Wigner-D). The given model is left as it is.

A known track is *subtracted* in verification by carrying the same edits out on the record's unmarked reference: the
displacement read is then C' minus the edited C, which is the mark again. Subtracting the values that the edits added to
the marked model would instead carry a part of the mark (gain minus one times it) into every suspect, marked or not.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal, NamedTuple

import numpy as np
import numpy.typing as npt
from scipy.spatial.transform import Rotation

from engine.errors import InputError
from engine.flows.records.opened_record import OpenedRecord
from engine.flows.verify.search import Verification, verify_model
from engine.lab.sim.attack import check_positive
from engine.lab.sim.edits.selection import check_selection
from engine.lab.sim.model_placement import join
from engine.lab.sim.vectors import check_triple
from engine.model import ATTRIBUTES, SH_C0, Bool, Float32, Float64, GaussianModel, Int64
from engine.numerics.similarity import transform_model
from engine.numerics.umeyama import Similarity

Action = Literal["change", "delete", "duplicate"]


@dataclass(frozen=True, eq=False)
class Recoloring:
    """new color = gain * color + tint, for every direction of view; before clipping."""

    gain: Float64  # (3,) factor on red, green and blue, >= 0
    tint: Float64  # (3,) added, colors ranging 0 to 1

    @classmethod
    def none(cls) -> Recoloring:
        """The recoloring that changes nothing."""
        return cls(np.ones(3), np.zeros(3))

    @property
    def offset(self) -> Float64:
        """(3,) what is added to gain * DC, SH units: color = 0.5 + SH_C0 * DC."""
        return np.asarray((0.5 * (self.gain - 1.0) + self.tint) / SH_C0)

    def apply(self, sh: Float32) -> Float32:
        """(n, K, 3) SH recolored."""
        new = sh.astype(np.float64) * self.gain
        new[:, 0] += self.offset
        return new.astype(np.float32)


class Edited(NamedTuple):
    """What an operation gives back: the edited model, and the edit for an `EditTrack`."""

    model: GaussianModel
    edit: Edit


@dataclass(frozen=True, eq=False)
class Edit:
    """One local edit. It can be repeated on another model of the same Gaussians, and undone.

    What is kept to *replay* it are its parameters, never the values it gave: replayed on a record's unmarked reference
    it makes an edited reference without a trace of a mark (DESIGN 4.9). The values from before *take it back*.
    """

    name: str
    # `change`: the rows are moved and recolored in place. `delete`: they are removed. `duplicate`: moved and
    # recolored copies of them are appended
    action: Action
    count: int  # Gaussians of the model before the edit
    rows: Int64  # (n,) the Gaussians concerned, ascending
    before: GaussianModel  # their values before
    similarity: Similarity  # x_new = scale * R @ x + t
    recoloring: Recoloring
    filling: GaussianModel | None = None  # new Gaussians appended by a deletion that fills its hole

    def apply(self, model: GaussianModel, *, filling: bool = True) -> GaussianModel:
        """The model after this edit; `filling` False leaves out what filled a hole.

        InputError if the model has another number of Gaussians than the edit was made for.
        """
        _check_count(self.name, len(model), self.count)
        if self.action == "change":
            return _replaced(model, self.rows, self._changed(model.take(self.rows)))
        if self.action == "duplicate":
            return join(model, self._changed(model.take(self.rows)))
        left = model.take(self._kept())
        return join(left, self.filling) if filling and self.filling is not None else left

    def undo(self, model: GaussianModel) -> GaussianModel:
        """The model before this edit, bit for bit where nothing else has touched the rows since.

        InputError if the model has another number of Gaussians than the edit left.
        """
        _check_count(f"undoing {self.name}", len(model), len(self.origin()))
        if self.action == "change":
            return _replaced(model, self.rows, self.before)
        if self.action == "duplicate":
            return model.take(np.arange(self.count))
        both = join(model.take(np.arange(self.count - len(self.rows))), self.before)
        return both.take(np.argsort(np.concatenate([self._kept(), self.rows])))  # the inverse of that order

    def origin(self) -> Int64:
        """(M,) row before the edit of every Gaussian after it: a copy's is its source's, a filling's is -1."""
        everyone = np.arange(self.count, dtype=np.int64)
        if self.action == "change":
            return everyone
        if self.action == "duplicate":
            return np.concatenate([everyone, self.rows])
        filled = 0 if self.filling is None else len(self.filling)
        return np.concatenate([self._kept(), np.full(filled, -1, np.int64)])

    def _changed(self, part: GaussianModel) -> GaussianModel:
        s = self.similarity
        if not (s.scale == 1.0 and np.array_equal(s.R, np.eye(3)) and not s.t.any()):
            part = transform_model(part, s.scale, s.R, s.t)
        if (self.recoloring.gain != 1.0).any() or self.recoloring.tint.any():
            part = part.with_(sh=self.recoloring.apply(part.sh))
        return part

    def _kept(self) -> Int64:
        return np.delete(np.arange(self.count, dtype=np.int64), self.rows)


def _replaced(model: GaussianModel, rows: Int64, part: GaussianModel) -> GaussianModel:
    new = model.take(np.arange(len(model)))
    for name in ATTRIBUTES:
        getattr(new, name)[rows] = getattr(part, name)
    return new


def _check_count(what: str, count: int, expected: int) -> None:
    if count != expected:
        raise InputError(f"edit {what!r} is for a model of {expected} Gaussians, got {count}")


def move(model: GaussianModel, selection: Bool, shift: npt.ArrayLike) -> Edited:
    """Shift the selected Gaussians by (3,) scene units."""
    return _edit("move", model, selection, Similarity(1.0, np.eye(3), check_triple(shift, "shift")))


def rotate(model: GaussianModel, selection: Bool, axis: npt.ArrayLike, degrees: float) -> Edited:
    """Turn the selected Gaussians, right-handed, about an axis (3,), not zero, through the middle of their box."""
    direction = check_triple(axis, "axis")
    length = float(np.linalg.norm(direction))
    if length == 0:
        raise InputError("the axis of a rotation must not be zero")
    if not np.isfinite(degrees):
        raise InputError(f"angle must be finite, got {degrees}")
    R = Rotation.from_rotvec(np.radians(degrees) * direction / length).as_matrix()
    return _edit("rotate", model, selection, _about_middle(model, selection, 1.0, R))


def scale(model: GaussianModel, selection: Bool, factor: float) -> Edited:
    """Scale the selected Gaussians by `factor` > 0 about the middle of their box."""
    check_positive(factor, "scale factor")
    return _edit("scale", model, selection, _about_middle(model, selection, factor, np.eye(3)))


def place(model: GaussianModel, selection: Bool, similarity: Similarity) -> Edited:
    """Move, turn and scale the selected Gaussians at once: x_new = scale * R @ x + t."""
    return _edit("place", model, selection, similarity)


def recolor(model: GaussianModel, selection: Bool, *, gain: npt.ArrayLike = 1.0, tint: npt.ArrayLike = 0.0) -> Edited:
    """Multiply the colors of the selected Gaussians by `gain` >= 0, then add `tint`; each scalar or (3,)."""
    change = Recoloring(_channels(gain, "gain"), _channels(tint, "tint"))
    if (change.gain < 0).any():
        raise InputError(f"gain must not be negative, got {change.gain.tolist()}")
    return _edit("recolor", model, selection, recoloring=change)


def recolor_towards(model: GaussianModel, selection: Bool, color: npt.ArrayLike, strength: float = 1.0) -> Edited:
    """Paint the selected Gaussians: color = (1 - strength) * color + strength * target, scalar or (3,), 0 to 1.

    At strength 1 the target is all that is left, and nothing of a mark.
    """
    if not 0 <= strength <= 1:
        raise InputError(f"strength of a recoloring must lie in [0, 1], got {strength}")
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


def _about_middle(model: GaussianModel, selection: Bool, factor: float, R: Float64) -> Similarity:
    """The similarity of that factor and rotation that leaves the middle of the selection's bounding box where it is."""
    means = model.means[check_selection(model, selection)].astype(np.float64)
    pivot = 0.5 * (means.min(axis=0) + means.max(axis=0))
    return Similarity(factor, R, pivot - factor * R @ pivot)


def _channels(value: npt.ArrayLike, what: str) -> Float64:
    array = np.asarray(value, dtype=np.float64)
    if array.shape not in ((), (3,)) or not np.isfinite(array).all():
        raise InputError(f"{what} must be one finite number or three, got {value!r}")
    return np.broadcast_to(array, (3,)).copy()


@dataclass(frozen=True, eq=False)
class EditTrack:
    """Edits, first to last; each was made on the model that the one before it left."""

    edits: tuple[Edit, ...] = ()

    def then(self, edit: Edit) -> EditTrack:
        """The track with one more edit; InputError if that edit starts from another number of Gaussians."""
        end = len(self.edits[-1].origin()) if self.edits else edit.count
        if end != edit.count:
            raise InputError(f"edit {edit.name!r} starts from {edit.count} Gaussians, the track ends at {end}")
        return EditTrack((*self.edits, edit))

    def replay(self, model: GaussianModel, *, filling: bool = True) -> GaussianModel:
        """All edits carried out on a model of the same Gaussians; `filling` as in `Edit.apply`.

        Without filling, the rows of later edits that concern filled-in Gaussians are passed over.
        """
        if filling:
            for edit in self.edits:
                model = edit.apply(model)
            return model
        real = np.ones(len(model), dtype=np.bool_)  # of the track's own Gaussians, which the model holds
        for edit in self.edits:
            place = np.cumsum(real) - 1
            rows = place[edit.rows[real[edit.rows]]]
            own = replace(edit, count=len(model), rows=rows, filling=None)
            model = own.apply(model) if len(rows) else model
            origin = edit.origin()
            real = np.where(origin >= 0, real[np.maximum(origin, 0)], False)
        return model

    def undo(self, model: GaussianModel, steps: int | None = None) -> GaussianModel:
        """The model before the last `steps` edits (all by default), bit for bit.

        InputError if the track is shorter, or the model is not of the length that the track left.
        """
        steps = len(self.edits) if steps is None else steps
        if not 0 <= steps <= len(self.edits):
            raise InputError(f"cannot undo {steps} of {len(self.edits)} edits")
        for edit in reversed(self.edits[len(self.edits) - steps :]):
            model = edit.undo(model)
        return model

    def origin(self, count: int) -> Int64:
        """(M,) row in the first model (of `count` Gaussians) of every Gaussian of the last; -1: filled in."""
        rows = np.arange(count, dtype=np.int64)
        for edit in self.edits:
            step = edit.origin()
            rows = np.where(step >= 0, rows[np.maximum(step, 0)], -1)
        return rows


def edited_record(opened: OpenedRecord, track: EditTrack) -> OpenedRecord:
    """A record whose reference went through the same edits; chips, message and strength as they are.

    Gaussians keep the code vectors of the ones they come from; what filled a hole is no part of it. InputError if the
    track starts from another number of Gaussians than the reference has.
    """
    count = len(opened.reference)
    if track.edits and track.edits[0].count != count:
        raise InputError(f"the track starts from {track.edits[0].count} Gaussians, the record's reference has {count}")
    origin = track.origin(count)
    origin = origin[origin >= 0]
    reference = track.replay(opened.reference, filling=False)
    return replace(opened, reference=reference, layout=opened.layout.at(origin), copies=None)


def verify_edited(suspect: GaussianModel, opened: OpenedRecord, track: EditTrack) -> Verification:
    """Does this model carry the record's mark, when the edits it went through are known?

    The suspect is the marked model after the track's edits, and after whatever else happened to it since. A note says
    that a track was subtracted: the bound holds for a track that was fixed without knowledge of the chips; one made up
    by a claimant could name any Gaussians it liked, so such a claim is only as good as the track's source.
    """
    found = verify_model(suspect, edited_record(opened, track))
    names = ", ".join(edit.name for edit in track.edits) or "none"
    note = f"a known track of {len(track.edits)} edits was subtracted ({names}): the bound trusts its source"
    return replace(found, claim=replace(found.claim, notes=(*found.claim.notes, note)))
