"""The run of a scenario: one step after the other, a verification and a picture after each.

1. Load the objects; mark those to be marked.       3. After each, look for every record in what is left.
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
from engine.flows.verify.search import verify_images, verify_model
from engine.lab.sim.scenario.film import Show
from engine.lab.sim.scenario.script import Scenario
from engine.lab.sim.scenario.sources import load_world
from engine.lab.sim.scenario.state import Finding, Outcome
from engine.model import GaussianModel

DELIVERED = "as delivered"


@dataclass(frozen=True, eq=False)
class StepResult:
    """One step and what was found after it."""

    label: str
    findings: tuple[Finding, ...]  # one for each record
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
    scenario: Scenario, progress: Progress | None = None, on_result: Callable[[StepResult], None] | None = None
) -> Run:
    """Play a scenario; `on_result` is called with every result as soon as it is there.

    InputError, naming the step, if one does not fit the world it meets.
    """
    report = progress or (lambda stage, fraction: None)
    world, made = load_world(scenario.parts, scenario.seed, report)  # 1
    show = Show(scenario.film, world.flat())
    results: list[StepResult] = []

    def finish(label: str, outcome: Outcome, seconds: float) -> None:
        findings = tuple(_look_for_all(outcome, label, report))  # 3
        picture = show.add(label, outcome, findings)  # 4
        result = StepResult(label, findings, picture, seconds, outcome.notes)
        results.append(result)
        if on_result:
            on_result(result)

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


def _look_for_all(outcome: Outcome, label: str, progress: Progress) -> list[Finding]:
    """A finding for each record of the world."""
    findings = []
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
        findings.append(Finding.of(name, claim, outcome.cost, time.perf_counter() - began))
    return findings
