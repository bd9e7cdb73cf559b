"""One edit as a value: which Gaussians, what was done to them, and how to take it back."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, NamedTuple

import numpy as np
import numpy.typing as npt

from engine.errors import InputError
from engine.lab.sim.model_placement import join
from engine.model import ATTRIBUTES, SH_C0, Float32, Float64, GaussianModel, Int64
from engine.numerics.similarity import transform_model
from engine.numerics.umeyama import Similarity

__all__ = ["Action", "Attribute", "Edit", "Edited", "Recoloring"]

Action = Literal["change", "delete", "duplicate"]
Attribute = Literal["means", "log_scales", "quats", "opacity_logits", "sh"]


@dataclass(frozen=True, eq=False)
class Recoloring:
    """new colour = gain * colour + tint, for every direction of view; before clipping."""

    gain: Float64  # (3,) factor on red, green and blue, >= 0
    tint: Float64  # (3,) added, colours ranging 0 to 1

    @classmethod
    def none(cls) -> Recoloring:
        """The recolouring that changes nothing."""
        return cls(np.ones(3), np.zeros(3))

    @property
    def offset(self) -> Float64:
        """(3,) what is added to gain * DC, SH units: colour = 0.5 + SH_C0 * DC."""
        return np.asarray((0.5 * (self.gain - 1.0) + self.tint) / SH_C0)

    def apply(self, sh: Float32) -> Float32:
        """(n, K, 3) SH recoloured."""
        new = sh.astype(np.float64) * self.gain
        new[:, 0] += self.offset
        return new.astype(np.float32)


class Edited(NamedTuple):
    """What an operation gives back: the edited model, and the edit for an `EditTrack`."""

    model: GaussianModel
    edit: Edit


@dataclass(frozen=True, eq=False)
class Edit:
    """One local edit. It can be carried out again on another model of the same Gaussians, and taken back.

    What is kept to *replay* it are its parameters, never the values it gave: replayed on a record's unmarked reference
    it makes an edited reference without a trace of a mark (DESIGN 4.9). The values from before *take it back*.
    """

    name: str
    # `change`: the rows are moved and recoloured in place. `delete`: they are removed. `duplicate`: moved and
    # recoloured copies of them are appended
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

    def delta(self, attribute: Attribute) -> npt.NDArray[np.float32]:
        """(n, ...) what the edit added to an attribute of its rows (C'_k - C_k for "sh"); 0 for a deletion."""
        old = getattr(self.before, attribute)
        return np.asarray(getattr(self._changed(self.before), attribute) - old)

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
