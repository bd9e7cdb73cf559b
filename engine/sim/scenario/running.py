"""The run of a scenario: one step after the other, a verification and a picture after each.

1. Load the objects; mark those that want a mark.   3. After each, look for every record in what is left.
2. Carry the steps out in their order.              4. Show it: a picture a step, a film of all.
"""

from __future__ import annotations

import hashlib
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from engine.errors import InputError
from engine.formats import read_model
from engine.model import Float32, GaussianModel
from engine.numerics.similarity import transform_model
from engine.pipeline.embedding import embed
from engine.pipeline.profiles import profile
from engine.pipeline.progress import Progress
from engine.pipeline.sealing import open_record
from engine.pipeline.verification import Verification, verify_images, verify_model
from engine.sim.scenario.script import Part, Scenario
from engine.sim.scenario.showing import Show
from engine.sim.scenario.world import Outcome, World
from engine.watermark.keys import OwnerKey

__all__ = ["Run", "StepResult", "run_scenario", "scenario_key"]

DELIVERED = "as delivered"


@dataclass(frozen=True, eq=False)
class StepResult:
    """One step and what was found after it.

    Parameters
    ----------
    label : str
    rows : tuple of dict
        One for each record: object, verdict, matching bits, z, bound, share found, seconds.
    picture : (H, W, 3) uint8
        What a person would see, with the findings written on it.
    seconds : float
        Of the step itself.
    notes : tuple of str
    """

    label: str
    rows: tuple[dict[str, Any], ...]
    picture: Any
    seconds: float
    notes: tuple[str, ...]


@dataclass(frozen=True, eq=False)
class Run:
    """A finished scenario: results in order, frames of the film (H, W, 3) uint8, and the model at its end."""

    scenario: Scenario
    results: tuple[StepResult, ...]
    frames: tuple[Any, ...]
    model: GaussianModel


def run_scenario(
    scenario: Scenario,
    progress: Progress | None = None,
    tell: Callable[[StepResult], None] | None = None,
) -> Run:
    """Play a scenario.

    Parameters
    ----------
    scenario : Scenario
    progress : callable, optional
        Told step and fraction.
    tell : callable, optional
        Given every result as soon as it is there.

    Returns
    -------
    Run

    Raises
    ------
    InputError
        If a step does not fit the world it meets; the message names the step.
    """
    report = progress or (lambda stage, fraction: None)
    world = load_world(scenario, report)  # 1
    show = Show(scenario.film, world.flat())
    results: list[StepResult] = []

    def finish(label: str, outcome: Outcome, seconds: float) -> None:
        rows = tuple(_look_for_all(outcome, label, report))  # 3
        picture = show.add(label, outcome, rows)  # 4
        result = StepResult(label, rows, picture, seconds, outcome.notes)
        results.append(result)
        if tell:
            tell(result)

    finish(DELIVERED, Outcome(world), 0.0)
    for number, named in enumerate(scenario.steps):  # 2
        label = f"{number + 1}. {named.label}"
        report(label, 0.0)
        began = time.perf_counter()
        try:
            outcome = named.step.run(
                world,
                np.random.default_rng((scenario.seed, number)),
                lambda fraction, label=label: report(label, fraction),  # type: ignore[misc]
            )
        except InputError as error:
            raise InputError(f"step {label!r}: {error}") from error
        world = outcome.world
        finish(label, outcome, time.perf_counter() - began)
    return Run(scenario, tuple(results), tuple(show.frames), world.flat())


def scenario_key(seed: int) -> OwnerKey:
    """The owner's key of a scenario: reproducible, so never for real use."""
    return OwnerKey(hashlib.sha256(f"mark3dgs scenario key {seed}".encode()).digest())


def load_world(scenario: Scenario, progress: Progress) -> World:
    """Objects read, marked and placed."""
    key = scenario_key(scenario.seed)
    world = World({}, {}, {})
    for part in scenario.parts:
        loaded = read_model(part.model)
        model = loaded.model
        if part.bits:

            def told(stage: str, fraction: float, part: Part = part) -> None:
                progress(f"marking {part.name}: {stage}", fraction)

            made = embed(
                model, key, original_sha256=loaded.sha256, bits=part.bits, config=profile(part.profile),
                copy=part.name, progress=told,
            )  # fmt: skip
            opened = open_record(made.record.to_bytes(key), key)
            world = replace(world, records={**world.records, part.name: opened})
            model = made.model
        world = replace(
            world,
            objects={**world.objects, part.name: _place(model, part)},
            unmarked={**world.unmarked, part.name: _place(loaded.model, part)},
        )
    return world


def _place(model: GaussianModel, part: Part) -> GaussianModel:
    turn = Rotation.from_rotvec(np.radians(part.turn)).as_matrix()
    if part.scale == 1.0 and not any(part.shift) and not any(part.turn):
        return model
    return transform_model(model, part.scale, turn, np.asarray(part.shift))


def _look_for_all(outcome: Outcome, label: str, progress: Progress) -> list[dict[str, Any]]:
    """A row for each record of the world."""
    rows = []
    flat = outcome.world.flat() if not outcome.pictures else None
    for name, opened in outcome.world.records.items():
        progress(f"{label}: looking for {name}", 0.0)
        if flat is not None:
            found = verify_model(flat, opened)
        else:
            pictures: list[Float32] = list(outcome.pictures)
            found = verify_images(pictures, opened, cameras=outcome.cameras)
        rows.append(row(name, found))
    return rows


def row(name: str, found: Verification) -> dict[str, Any]:
    """One line of the table."""
    claim = found.claim
    return {
        "object": name,
        "verdict": claim.verdict.value,
        "matching_bits": claim.matching_bits,
        "bits": claim.bits,
        "z": claim.z,
        "log10_false_claim": claim.log10_false_claim,
        "derived_fraction": claim.derived_fraction,
        "route": claim.route,
        "seconds": found.seconds,
    }
