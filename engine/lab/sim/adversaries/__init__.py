"""Adversaries: whoever has marked models and wants the mark gone, diluted, or on somebody else's work.

Each module is one idea and names its source; suites, scenarios and studies come in by `engine.lab.sim.attacks`. Start
at `purification` or `collusion`; `published` has the severities of other systems' papers.
"""
