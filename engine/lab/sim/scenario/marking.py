"""The start of a scenario: objects as they are written, brought, marked as what they are, and placed."""

import hashlib
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from engine.flows.embed.embedding import embed
from engine.flows.embed.profiles import profile
from engine.flows.progress import Progress
from engine.flows.records.opened_record import OpenedRecord, open_record
from engine.lab.sim.edits.operations import place
from engine.lab.sim.edits.tracking import EditTrack
from engine.lab.sim.scenario.bringing import KINDS, Brought, Source, bring, read_name, read_source
from engine.lab.sim.scenario.tables import Table, given
from engine.lab.sim.scenario.world import Clip, Tracked, World
from engine.lab.sim.variants.generative import marking
from engine.lab.sim.variants.hybrid import HybridPart
from engine.model import GaussianModel
from engine.numerics.similarity import transform_model
from engine.numerics.umeyama import Similarity
from engine.scenes.clip_marking import Moving, move_record
from engine.scenes.codebook_model import CodebookModel
from engine.scenes.scene_marking import embed_variant
from engine.watermark.keys import OwnerKey
from engine.watermark.rates import MADE_FIRST

__all__ = ["Part", "load_world", "mark", "scenario_key"]


@dataclass(frozen=True)
class Part:
    """One object at the start."""

    source: Source = given(read_source)  # a model file, or what to make one from
    name: str = given(read_name)
    bits: int = given(Table.integer, 32, 0, 256)  # length of its message; 0 leaves it unmarked
    profile: str = given(Table.text, "balanced")  # of the embedding
    kind: str = given(Table.text, "as it is", tuple(KINDS))  # what is made of it before it is marked
    shift: tuple[float, ...] = given(Table.vector, (0.0, 0.0, 0.0))  # scene units
    turn: tuple[float, ...] = given(Table.vector, (0.0, 0.0, 0.0))  # rotation vector, degrees
    scale: float = given(Table.number, 1.0, 1e-6, 1e6)


def scenario_key(seed: int) -> OwnerKey:
    """The owner's key of a scenario: reproducible, so never for real use."""
    return OwnerKey(hashlib.sha256(f"mark3dgs scenario key {seed}".encode()).digest())


def load_world(parts: Sequence[Part], seed: int, progress: Progress) -> tuple[World, tuple[str, ...]]:
    """The world as delivered, and what there is to say about how it came to be."""
    world = World({}, {}, {}, {}, scenario_key(seed))
    notes: list[str] = []
    for part in parts:

        def told(stage: str, fraction: float, part: Part = part) -> None:
            progress(f"{part.name}: {stage}", fraction)

        brought = bring(part.source, part.name, part.kind, seed, told)
        notes += [brought.note] if brought.note else []
        made = _mark_part(brought, part, world.key, told)
        world = _put(world, part, made)
    return world, tuple(notes)


class _Made(NamedTuple):
    """An object, marked, in its own frame."""

    still: GaussianModel  # what the world holds of it
    unmarked: GaussianModel
    opened: OpenedRecord | None
    moving: tuple[Moving, Moving] | None = None  # marked and original, where it moves


def _mark_part(brought: Brought, part: Part, key: OwnerKey, told: Progress) -> _Made:
    """Marked as what it is: plain Gaussians and discs, codebooks, clips, and what a generator makes."""
    loaded, config = brought.loaded, profile(part.profile)
    scene = loaded.scene
    if isinstance(scene, GaussianModel):
        if not part.bits:
            return _Made(scene, scene, None)
        if loaded.format == "generated":
            return _mark_at_birth(scene, key, part)
        marked, opened = mark(scene, key, loaded.sha256, part.bits, part.profile, copy=part.name, progress=told)
        return _Made(marked, scene, opened)
    new, opened_new = scene, None
    if part.bits:
        marks = embed_variant(loaded, key, (part.name,), config=config, bits=part.bits, progress=told)
        ((made, embedding),) = marks
        assert not isinstance(made, GaussianModel)  # the same kind comes back
        new, opened_new = made, open_record(embedding.record.to_bytes(key), key, MADE_FIRST)
    if isinstance(scene, CodebookModel) or isinstance(new, CodebookModel):
        return _Made(HybridPart(new, Similarity.identity()).still(), loaded.model, opened_new)
    still = HybridPart(new, Similarity.identity(), _middle(scene)).still()
    return _Made(still, loaded.model, opened_new, (new, scene))


def _mark_at_birth(grown: GaussianModel, key: OwnerKey, part: Part) -> _Made:
    """Through the generator's hook: nothing leaves it without a mark, and the record is there before."""
    with tempfile.TemporaryDirectory() as folder:
        marked = marking(key, folder, bits=part.bits)(lambda: grown)()
        (record,) = Path(folder).glob("*.record")
        return _Made(marked, grown, open_record(record.read_bytes(), key, MADE_FIRST))


def _middle(clip: Moving) -> float:
    return 0.5 * (clip.span[0] + clip.span[1])


def _put(world: World, part: Part, made: _Made) -> World:
    """The world with one more object in its place."""
    turn = Rotation.from_rotvec(np.radians(part.turn)).as_matrix()
    there = Similarity(part.scale, turn, np.asarray(part.shift))
    still, track = made.still, EditTrack()
    if part.scale != 1.0 or any(part.shift) or any(part.turn):
        still, edit = place(still, np.ones(len(still), dtype=np.bool_), there)  # the first thing done to it
        track = track.then(edit)
    records, clips, tracks = dict(world.records), dict(world.clips), dict(world.tracks)
    if made.moving is None:
        tracks[part.name] = Tracked(track, still)
    if made.opened is not None:
        records[part.name] = made.opened
    if made.opened is not None and made.moving is not None:
        marked, original = made.moving
        put = partial(transform_model, scale=part.scale, R=turn, t=np.asarray(part.shift))
        clips[part.name] = Clip(marked, original, made.opened, put, _middle(original), still)
        records[part.name] = move_record(made.opened, original, _middle(original))
    return replace(
        world,
        objects={**world.objects, part.name: still},
        unmarked={**world.unmarked, part.name: made.unmarked},
        profiles={**world.profiles, part.name: part.profile},
        records=records,
        clips=clips,
        tracks=tracks,
    )


def mark(
    model: GaussianModel,
    key: OwnerKey,
    digest: str,
    bits: int,
    profile_name: str,
    *,
    copy: str,
    progress: Progress | None = None,
) -> tuple[GaussianModel, OpenedRecord]:
    """The marked model and its record, which has made the round trip through its bytes."""
    made = embed(
        model, key, original_sha256=digest, bits=bits, config=profile(profile_name), copy=copy, progress=progress
    )
    return made.model, open_record(made.record.to_bytes(key), key, MADE_FIRST)
