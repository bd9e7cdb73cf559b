"""Attacks by adversaries who know how marks work: removal, dilution, copying the mark onto another model.

Each module is one idea and names its source; suites, scenarios and studies come in by `engine.lab.sim.attacks`. Start
at `purification` or `collusion`; `model_values` has the severities of FlyMark's table.
"""
