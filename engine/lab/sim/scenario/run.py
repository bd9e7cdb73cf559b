"""The run of a scenario: one step after the other, a verification and a picture after each.

1. Load the objects; mark those that want a mark.   3. After each, look for every record in what is left.
2. Carry the steps out in their order.              4. Show it: a picture a step, a film of all.
"""

import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np

from engine.errors import InputError
from engine.flows.progress import Progress
from engine.flows.verify.verification import verify_images, verify_model
from engine.lab.sim.cost import Cost
from engine.lab.sim.scenario.film import Show
from engine.lab.sim.scenario.script import Scenario
from engine.lab.sim.scenario.sources import load_world
from engine.lab.sim.scenario.state import Outcome
from engine.model import GaussianModel
from engine.watermark.claim import Claim

__all__ = ["Run", "StepResult", "run_scenario"]


DELIVERED = "as delivered"


@dataclass(frozen=True, eq=False)
class StepResult:
    """One step and what was found after it."""

    label: str
    # one for each record: object, verdict, matching bits, z, bound, share found, seconds
    rows: tuple[dict[str, Any], ...]
    picture: Any  # (H, W, 3) uint8, what a person would see, with the findings written on it
    seconds: float  # of the step itself
    notes: tuple[str, ...]


@dataclass(frozen=True, eq=False)
class Run:
    """A finished scenario: results in order, frames of the film (H, W, 3) uint8, and the model at its end."""

    scenario: Scenario
    results: tuple[StepResult, ...]
    frames: tuple[Any, ...]
    model: GaussianModel


def run_scenario(
    scenario: Scenario, progress: Progress | None = None, tell: Callable[[StepResult], None] | None = None
) -> Run:
    """Play a scenario; `tell` is given every result as soon as it is there.

    InputError, naming the step, if one does not fit the world it meets.
    """
    report = progress or (lambda stage, fraction: None)
    world, made = load_world(scenario.parts, scenario.seed, report)  # 1
    show = Show(scenario.film, world.flat())
    results: list[StepResult] = []

    def finish(label: str, outcome: Outcome, seconds: float) -> None:
        rows = tuple(_look_for_all(outcome, label, report))  # 3
        picture = show.add(label, outcome, rows)  # 4
        result = StepResult(label, rows, picture, seconds, outcome.notes)
        results.append(result)
        if tell:
            tell(result)

    finish(DELIVERED, Outcome(world, notes=made), 0.0)
    for number, named in enumerate(scenario.steps):  # 2
        label = f"{number + 1}. {named.label}"
        report(label, 0.0)
        began = time.perf_counter()
        try:
            outcome = named.step.run(world, np.random.default_rng((scenario.seed, number)), partial(report, label))
        except InputError as error:
            raise InputError(f"step {label!r}: {error}") from error
        world = outcome.world
        finish(label, outcome, time.perf_counter() - began)
    return Run(scenario, tuple(results), tuple(show.frames), world.flat())


def _look_for_all(outcome: Outcome, label: str, progress: Progress) -> list[dict[str, Any]]:
    """A row for each record of the world."""
    rows = []
    flat = outcome.world.flat()
    for name, opened in outcome.world.records.items():
        progress(f"{label}: looking for {name}", 0.0)
        began = time.perf_counter()
        if name in outcome.claims:
            claim = outcome.claims[name]
        elif outcome.pictures:
            claim = verify_images(list(outcome.pictures), opened, cameras=outcome.cameras).claim
        else:
            claim = verify_model(flat, opened).claim
        rows.append(row(name, claim, outcome.cost, time.perf_counter() - began))
    return rows


def row(name: str, claim: Claim, cost: Cost | None, seconds: float) -> dict[str, Any]:
    """One line of the table."""
    return {
        "object": name,
        "verdict": claim.verdict.value,
        "matching_bits": claim.matching_bits,
        "bits": claim.bits,
        "z": claim.z,
        "log10_false_claim": claim.log10_false_claim,
        "derived_fraction": claim.derived_fraction,
        "route": claim.route,
        "psnr_cost": cost.psnr if cost else None,
        "coverage": cost.coverage if cost else None,
        "covered_psnr": cost.covered_psnr if cost else None,
        "seconds": seconds,
    }
