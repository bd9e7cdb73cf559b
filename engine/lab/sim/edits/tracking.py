"""Edit tracks: the edits of a model in their order, C'_k = C_k + delta C_k (paper, MarkGS-Sim).

A known track is *subtracted* in verification by carrying the same edits out on the record's unmarked
reference: the displacement read is then C' minus the edited C, which is the mark again. The other way round,
subtracting the values that the edits added to the marked model, would carry a part of the mark (gain minus
one times it) into every suspect, marked or not.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from engine.errors import InputError
from engine.flows.records.opened_record import OpenedRecord
from engine.flows.verify.decision import VerifyConfig
from engine.flows.verify.verification import Verification, verify_model
from engine.lab.sim.edits.edit import Edit
from engine.model import Float32, GaussianModel, Int64

__all__ = ["EditTrack", "edited_record", "verify_edited"]


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

    def displacement(self, before: GaussianModel) -> Float32:
        """(M, K, 3) delta C of every Gaussian of the last model: its SH less that of its row in the first, `before`.

        Gaussians that were filled in have displacement 0: they have no C of their own.
        """
        after, origin = self.replay(before), self.origin(len(before))
        delta = after.sh - before.sh[np.maximum(origin, 0)]
        delta[origin < 0] = 0.0
        return delta


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
    layout = replace(opened.layout, labels=tuple(label[origin] for label in opened.layout.labels))
    return replace(opened, reference=track.replay(opened.reference, filling=False), layout=layout)


def verify_edited(
    suspect: GaussianModel, opened: OpenedRecord, track: EditTrack, config: VerifyConfig | None = None
) -> Verification:
    """Does this model carry the record's mark, when the edits it went through are known?

    The suspect is the marked model after the track's edits, and after whatever else happened to it since. A note says
    that a track was subtracted: the bound holds for a track that was fixed without knowledge of the chips; one made up
    by a claimant could name any Gaussians it liked, so such a claim is only as good as the track's source.
    """
    found = verify_model(suspect, edited_record(opened, track), config)
    names = ", ".join(edit.name for edit in track.edits) or "none"
    note = f"a known track of {len(track.edits)} edits was subtracted ({names}): the bound trusts its source"
    return replace(found, claim=replace(found.claim, notes=(*found.claim.notes, note)))
