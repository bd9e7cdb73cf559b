"""Steps of an owner who analyzes a suspect: edit maps, object inventories, and the mark read with the edits known."""

from dataclasses import dataclass, replace

import numpy as np

from engine.errors import InputError
from engine.lab.sim.edits.edit import verify_edited
from engine.lab.sim.edits.edit_map import Change, EditMap, map_edits
from engine.lab.sim.edits.pieces import verify_pieces
from engine.lab.sim.model_placement import join
from engine.lab.sim.scenario.state import Advance, Outcome, StepKind, Tracked, World, step
from engine.lab.sim.scenario.tables import Table, given
from engine.lab.sim.variants.hybrid import HybridPart, assemble, verify_hybrid
from engine.model import SH_C0, GaussianModel
from engine.numerics.similarity import mirror_model, transform_model
from engine.numerics.umeyama import Similarity
from engine.watermark.claim import Claim

KINDS: dict[str, StepKind] = {}

COLORS = {
    Change.RECOLORED: (1.0, 0.45, 0.05),
    Change.MOVED: (0.15, 0.5, 1.0),
    Change.COPIED: (0.95, 0.85, 0.1),
    Change.FOREIGN: (0.8, 0.25, 0.85),
}
REMOVED = (0.9, 0.1, 0.15)
DESCRIBED = 6  # regions of a map that are described in words


def _only(world: World, on: str) -> str:
    """The record meant: that of `on`, or the only one."""
    if not on and len(world.records) != 1:
        raise InputError(f"say `on`: which of {', '.join(world.records) or 'no marked objects'}")
    name = on or next(iter(world.records))
    world.record_of(name)
    return name


@step(KINDS, "map_edits", "a map of the edits found without a track of them: least, on")
@dataclass(frozen=True)
class MapEdits:
    """Orange recolored, blue moved, yellow copied, violet foreign, red removed; the world stays as it was."""

    least: float = given(Table.number, 0.02, 1e-6, 10.0)  # smallest color displacement of interest, DC units
    on: str = given(Table.text, "")

    def run(self, world: World, rng: np.random.Generator, advance: Advance) -> Outcome:
        name = _only(world, self.on)
        suspect = world.objects[name] if name in world.objects else world.flat()
        opened = world.record_of(name)
        found = map_edits(suspect, opened, least=self.least)
        notes = [region.summary() for region in found.regions[:DESCRIBED]] or ["nothing was edited"]
        notes.append(f"untouched Gaussians show {found.mark_left:.2f} of the mark")
        return Outcome(world, shown=paint_map(suspect, found, opened.reference), notes=tuple(notes))


def paint_map(suspect: GaussianModel, found: EditMap, reference: GaussianModel) -> GaussianModel:
    """The suspect in grey, its edits in their colors, and in red what was removed."""
    plain = suspect.with_(sh=suspect.sh[:, :1])
    grey = (0.5 + SH_C0 * plain.sh[:, 0]).mean(axis=1, keepdims=True).clip(0.0, 1.0)  # (N, 1)
    colors = np.repeat(0.25 + 0.5 * grey, 3, axis=1)
    for change, color in COLORS.items():
        rows = found.kinds == change
        colors[rows] = np.array(color) * (0.45 + 0.55 * grey[rows])
    painted = plain.with_dc(((colors - 0.5) / SH_C0).astype(np.float32))
    if not found.found or not found.removed.any():
        return painted
    gone = reference.take(np.flatnonzero(found.removed))
    gone = gone.with_(sh=np.tile((np.array(REMOVED, np.float32) - 0.5) / np.float32(SH_C0), (len(gone), 1, 1)))
    if found.pieces.mirrored[0]:
        gone = mirror_model(gone)
    back = found.pieces.placements[0].inverse()
    return join(painted, transform_model(gone, back.scale, back.R, back.t))


@step(KINDS, "known_edits", "the mark is read with the owner's track of edits: on")
@dataclass(frozen=True)
class KnownEdits:
    """The edits carried out on the record's reference, C'_k = C_k + delta C_k; a track ends at what is no edit."""

    on: str = given(Table.text, "")

    def run(self, world: World, rng: np.random.Generator, advance: Advance) -> Outcome:
        name = _only(world, self.on)
        known = world.tracks.get(name)
        if known is None:
            raise InputError(f"{name!r} has no track of edits: it moves, or is one of several copies")
        claim = verify_edited(world.flat(), world.record_of(name), known.track).claim
        names = ", ".join(edit.name for edit in known.track.edits) or "none"
        return Outcome(world, claims={name: claim}, notes=(f"{len(known.track.edits)} edits known: {names}",))


@step(KINDS, "undo", "the last edits are undone: edits, on")
@dataclass(frozen=True)
class Undo:
    """Bit for bit, as long as nothing but edits has happened since."""

    edits: int = given(Table.integer, 1, 1, 200)
    on: str = given(Table.text, "")

    def run(self, world: World, rng: np.random.Generator, advance: Advance) -> Outcome:
        name, model = world.target(self.on)
        known = world.tracks.get(name)
        if known is None or known.end is not model:
            raise InputError(f"the edits of {name!r} cannot be undone: another step has changed it since")
        before = known.track.undo(model, self.edits)
        left = replace(known.track, edits=known.track.edits[: -self.edits])
        world = world.put(name, before)
        return Outcome(replace(world, tracks={**world.tracks, name: Tracked(left, before)}))


@step(KINDS, "read_pieces", "the record is read piece by piece, parts having been moved: on")
@dataclass(frozen=True)
class ReadPieces:
    """Registers what earlier pieces left over, then makes one claim of all pieces."""

    on: str = given(Table.text, "")

    def run(self, world: World, rng: np.random.Generator, advance: Advance) -> Outcome:
        names = [_only(world, self.on)] if self.on else list(world.records)
        flat = world.flat()
        claims = {name: verify_pieces(flat, world.record_of(name)) for name in names}
        notes = tuple(f"{name}: {note}" for name, claim in claims.items() for note in claim.notes)
        return Outcome(world, claims=claims, notes=notes)


@step(KINDS, "inventory", "every record is searched in one file of many objects: instances")
@dataclass(frozen=True)
class Inventory:
    """Every record is looked for `instances` times; all tries count. What moves is looked for at its moment."""

    instances: int = given(Table.integer, 1, 1, 100)

    def run(self, world: World, rng: np.random.Generator, advance: Advance) -> Outcome:
        here = {name: HybridPart(model, Similarity.identity()) for name, model in world.objects.items()}
        moving = {name: (clip.original, clip.time) for name, clip in world.clips.items()}
        records = {**world.records, **{name: clip.opened for name, clip in world.clips.items()}}
        claims: dict[str, Claim] = {}
        notes = []
        for found in verify_hybrid(assemble(here), records, moving, instances=self.instances):
            best = claims.get(found.record)
            if best is None or found.claim.log10_false_claim < best.log10_false_claim:
                claims[found.record] = found.claim
            if found.objects:
                where = ", ".join(f"{100.0 * share:.0f} % in {name}" for name, share in found.objects[:2])
                notes.append(
                    f"{found.record}, place {found.instance + 1}: {found.claim.verdict.value},"
                    f" {100.0 * found.asset_share:.0f} % of it found, {where}"
                )
        return Outcome(world, claims=claims, notes=tuple(notes))
