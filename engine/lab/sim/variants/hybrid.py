"""Hybrid scenes: 3DGS, discs, one moment of a 4-D scene and decoded codebooks in one file, verified object by object.

Whatever a part was marked as, in a file of plain Gaussians it is an object like any other: its record finds it. A
part that moves is looked for with its record moved to its moment (`move_record`).
"""

from collections.abc import Mapping
from dataclasses import dataclass

from engine.errors import InputError
from engine.flows.records.opened_record import OpenedRecord
from engine.lab.sim.edits.objects import FlatScene, Scene
from engine.lab.sim.edits.pieces import ObjectFinding, verify_objects
from engine.model import GaussianModel
from engine.numerics.umeyama import Similarity
from engine.scenes.clip_marking import Moving, move_record, visible
from engine.scenes.codebook_model import CodebookModel


@dataclass(frozen=True, eq=False)
class HybridPart:
    """One object of a hybrid scene: the marked variant, where it stands and, where it moves, the moment shown."""

    marked: GaussianModel | CodebookModel | Moving
    placement: Similarity
    time: float | None = None

    def still(self) -> GaussianModel:
        """The part as plain Gaussians: codebooks looked up, a moving part as its export of that moment."""
        if isinstance(self.marked, GaussianModel):
            return self.marked
        if isinstance(self.marked, CodebookModel):
            return self.marked.decode()
        if self.time is None:
            raise InputError("a part that moves needs a time at which it is shown")
        return visible(self.marked.at(self.time))


def assemble(parts: Mapping[str, HybridPart]) -> FlatScene:
    """One file of all parts, with the owner of each Gaussian.

    The file is a plain one: discs become thin Gaussians in it, so a 2DGS viewer would draw it differently.
    """
    scene = Scene()
    for name, part in parts.items():
        scene = scene.insert(name, part.still(), part.placement)
    return scene.flatten()


def verify_hybrid(
    suspect: GaussianModel | FlatScene,
    records: Mapping[str, OpenedRecord],
    moving: Mapping[str, tuple[Moving, float]] | None = None,
    *,
    instances: int = 1,
) -> list[ObjectFinding]:
    """Which records a hybrid file carries, and where.

    `clip_marking` has, for records of scenes that move, the owner's original and the moment to look for. `instances`
    is how often one asset is looked for: more than once where several variants of the same asset may be in the file,
    which look alike to the registration although only one carries a given record's mark. All len(records) * instances
    tries are counted.
    """
    moving = moving or {}
    for name in moving:
        if name not in records:
            raise InputError(f"{name!r} moves, but there is no record of that name")
    at_their_time = {
        name: move_record(opened, *moving[name]) if name in moving else opened for name, opened in records.items()
    }
    return verify_objects(suspect, at_their_time, instances=instances)
