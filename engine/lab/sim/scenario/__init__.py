"""Scenarios: a marked model's life as a TOML file, played step by step and verified after each.

Who imports whom, from the ground up; each knows only those before it:

    tables      strict reading of TOML, and dataclasses whose fields say how they are read
    state       objects and records between two steps; what a step is, and what it leaves behind
    sources     objects at the start: read, trained, scanned or generated; marked and placed
    theft_steps, edit_steps, matter_steps, capture_steps, audit_steps
                the kinds of steps; a new one is a dataclass under `@step`, and nothing else
    script      the whole file, and every kind of step by its word
    film        pictures and film
    run         the run
"""

from engine.lab.sim.scenario.run import Run, StepResult, run_scenario
from engine.lab.sim.scenario.script import KINDS, Scenario, read_scenario

__all__ = ["KINDS", "Run", "Scenario", "StepResult", "read_scenario", "run_scenario"]
