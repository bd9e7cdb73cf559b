"""What a scenario plays with: objects, each perhaps with a mark of its own; what a step is and leaves behind."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import reduce
from typing import Protocol, TypeVar

import numpy as np

from engine.errors import InputError
from engine.flows.records.opened_record import OpenedRecord
from engine.flows.views.camera_rig import UP, Extent, direction
from engine.flows.views.config import CONFIG
from engine.lab.sim.attack_cost import Cost
from engine.lab.sim.edits.edit import EditTrack
from engine.lab.sim.model_placement import join
from engine.model import Camera, Float32, GaussianModel, look_at
from engine.scenes.clip_marking import Moving
from engine.watermark.claim import Claim
from engine.watermark.keys import OwnerKey

Advance = Callable[[float], None]
"""Called with the fraction of a step that is done."""

EVERYTHING = "everything"  # name of the one object that is left when a step treats the whole file as one
MARGIN = 1.3  # distance at which the robust sphere just fits, times this: what lies outside the sphere needs room, too


@dataclass(frozen=True, eq=False)
class Tracked:
    """The edits of an object since it was delivered, as its owner wrote them down."""

    track: EditTrack
    end: GaussianModel  # the object after the last of them; what happened to another one is on no track


@dataclass(frozen=True, eq=False)
class Clip:
    """An object that moves, of which the world holds one moment."""

    marked: Moving
    original: Moving  # the owner's, to which the record commits
    opened: OpenedRecord  # of the clip; the world's record is this one, moved to the moment
    place: Callable[[GaussianModel], GaussianModel]  # from the clip's frame into the world
    time: float
    shown: GaussianModel  # the moment, as it was put into the world


@dataclass(frozen=True, eq=False)
class World:
    """The state between two steps."""

    # in world coordinates, in the order in which they would be written to one file
    objects: Mapping[str, GaussianModel]
    # of the marked objects, under the names with which they came in; none is ever lost
    records: Mapping[str, OpenedRecord]
    # what was registered, before the mark, in its own frame; for attackers who have clean pictures
    unmarked: Mapping[str, GaussianModel]
    profiles: Mapping[str, str]  # profiles with which the objects were marked
    key: OwnerKey  # of the owner of all of them
    tracks: Mapping[str, Tracked] = field(default_factory=dict)  # of the objects as they came in
    clips: Mapping[str, Clip] = field(default_factory=dict)  # of the objects that move

    def flat(self) -> GaussianModel:
        """All objects in one file."""
        return reduce(join, self.objects.values())

    def target(self, on: str) -> tuple[str, GaussianModel]:
        """Name and model that a step works on: the named object, the only one, or all as one (`on` empty)."""
        if on:
            if on not in self.objects:
                raise InputError(f"no object is called {on!r}; there are {', '.join(self.objects)}")
            return on, self.objects[on]
        if len(self.objects) == 1:
            return next(iter(self.objects.items()))
        return EVERYTHING, self.flat()

    def put(self, name: str, model: GaussianModel) -> World:
        """The world with one object replaced; EVERYTHING replaces them all."""
        if len(model) == 0:
            raise InputError(f"nothing is left of {name!r}")
        if name == EVERYTHING:
            return replace(self, objects={EVERYTHING: model})
        return replace(self, objects={**self.objects, name: model})

    def record_of(self, name: str) -> OpenedRecord:
        """The record of an object; InputError where it carries none."""
        if name not in self.records:
            raise InputError(f"{name!r} carries no mark; marked are {', '.join(self.records) or 'none'}")
        return self.records[name]


@dataclass(frozen=True, eq=False)
class Outcome:
    """What a step leaves behind."""

    world: World
    frames: tuple[GaussianModel, ...] = ()  # moments in between, for the film; empty where nothing moves
    pictures: tuple[Float32, ...] = ()  # what turned up instead of the model; verification reads these then
    cameras: tuple[Camera, ...] | None = None  # of the pictures, where the verifier knows them
    shown: GaussianModel | None = None  # drawn instead of the world: a map of it
    claims: Mapping[str, Claim] = field(default_factory=dict)  # of records that the step has read in a way of its own
    notes: tuple[str, ...] = ()
    cost: Cost | None = None  # what the step cost the look, where it is an attack


@dataclass(frozen=True)
class Finding:
    """What was found of one record after a step: one line of the table."""

    object: str
    verdict: str
    matching_bits: int
    bits: int
    z: float
    log10_false_claim: float
    derived_fraction: float | None
    route: str
    psnr_cost: float | None  # dB; this and the next two are None where the step is no attack
    coverage: float | None
    covered_psnr: float | None
    seconds: float  # of the verification

    @classmethod
    def of(cls, name: str, claim: Claim, cost: Cost | None, seconds: float) -> Finding:
        """Of an object's claim, and of the step's cost."""
        return cls(
            name,
            claim.verdict.value,
            claim.matching_bits,
            claim.bits,
            claim.z,
            claim.log10_false_claim,
            claim.derived_fraction,
            claim.route,
            cost.psnr if cost else None,
            cost.coverage if cost else None,
            cost.covered_psnr if cost else None,
            seconds,
        )


class Step(Protocol):
    """One thing that happens to a world."""

    def run(self, world: World, rng: np.random.Generator, advance: Advance) -> Outcome:
        """Carry it out; the world given stays as it is."""
        ...


@dataclass(frozen=True)
class StepKind:
    """A kind of step: a dataclass of `given` fields, and one line for `mark3dgs sim --steps`."""

    made: type[Step]
    summary: str


S = TypeVar("S", bound=type[Step])


def step(kinds: dict[str, StepKind], word: str, summary: str) -> Callable[[S], S]:
    """Enters a class among `kinds` under the word by which scenarios call it."""

    def enter(made: S) -> S:
        kinds[word] = StepKind(made, summary)
        return made

    return enter


def viewpoint(extent: Extent, azimuth: float, elevation: float, width: int, height: int) -> Camera:
    """Camera on an orbit around a scene, or in the middle of a room looking out; angles in degrees."""
    toward = direction(np.radians(azimuth), np.radians(elevation))
    focal = width / (2.0 * np.tan(CONFIG.rig.field_of_view / 2.0))
    if extent.is_room:
        return look_at(extent.center, extent.center + extent.radius * toward, UP, focal, width, height)
    away = MARGIN * extent.radius / np.sin(np.arctan(min(width, height) / (2.0 * focal)))
    return look_at(extent.center + away * toward, extent.center, UP, focal, width, height)
