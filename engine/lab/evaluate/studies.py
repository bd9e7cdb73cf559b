"""The studies of `mark3dgs evaluate`, by name; a module is imported when its study is asked for."""

import importlib

from engine.errors import InputError
from engine.lab.evaluate.study import Study

STUDIES = {
    "pareto": ("engine.lab.evaluate.pareto.study", "speed against accuracy, and what a scene needs"),
    "stability": ("engine.lab.evaluate.stability.study", "every attack from harmless to ruinous; odd inputs"),
    "tables": ("engine.lab.evaluate.tables.study", "the paper's tables 1 to 6 and figures 6, 7; ablations"),
    "table1": ("engine.lab.evaluate.tables.study:table1", "of it: bits and fidelity by message length"),
    "table2": ("engine.lab.evaluate.tables.study:table2", "of it: bits after each attack, in all its readings"),
    "table3": ("engine.lab.evaluate.tables.study:table3", "of it: time, frames a second, size"),
    "table4": ("engine.lab.evaluate.tables.study:table4", "of it: 2DGS, 4DGS, codebooks, generated models"),
    "table5": ("engine.lab.evaluate.tables.study:table5", "of it: fine-tuning in four settings"),
    "table6": ("engine.lab.evaluate.tables.study:table6", "of it: losses of the refinement"),
    "fig6": ("engine.lab.evaluate.tables.study:fig6", "of it: hyper-parameters"),
    "fig7": ("engine.lab.evaluate.tables.study:fig7", "of it: pruning and strength"),
    "ablation": ("engine.lab.evaluate.tables.study:ablation", "of it: what each stage buys"),
    "paper": ("engine.lab.evaluate.tables.study:paper", "of it: the paper's own system, run by us"),
    "null": ("engine.lab.evaluate.null.study", "false claims: a million wrong keys, foreign marks, hostile suspects"),
    "steganalysis": ("engine.lab.evaluate.steganalysis.study", "can it be seen that there is a mark?"),
    "baselines": ("engine.lab.evaluate.baselines.study", "other methods on the same scenes and attacks"),
    "cost": ("engine.lab.evaluate.cost.study", "time and memory from 10 thousand to 10 million Gaussians"),
    "perceptual": ("engine.lab.evaluate.perceptual.study", "what eyes may notice: PSNR, SSIM, MS-SSIM, FLIP, LPIPS"),
}
"""Module and summary of each; the module holds `STUDY`, or after a colon: one of the module's `studies()`."""


def find_study(name: str) -> Study:
    """The study of that name."""
    if name not in STUDIES:
        raise InputError(f"there is no suite {name!r}; there are {', '.join(STUDIES)}")
    place, _, part = STUDIES[name][0].partition(":")
    module = importlib.import_module(place)
    study: Study = module.studies()[part] if part else module.STUDY
    return study
