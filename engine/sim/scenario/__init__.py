"""Scenarios: a marked model's life as a TOML file, played step by step and verified after each."""

from engine.sim.scenario.running import Run, StepResult, run_scenario
from engine.sim.scenario.script import Scenario, read_scenario
from engine.sim.scenario.steps import all_kinds

__all__ = ["Run", "Scenario", "StepResult", "all_kinds", "read_scenario", "run_scenario"]
