"""The studies of `mark3dgs evaluate`, by name; a module is imported when its study is asked for."""

from __future__ import annotations

import importlib

from engine.errors import InputError
from engine.evaluate.study import Study

STUDIES = {
    "pareto": ("engine.evaluate.pareto.study", "speed against accuracy, and what a scene needs"),
    "stability": ("engine.evaluate.stability.study", "every attack from harmless to ruinous; odd inputs"),
    "tables": ("engine.evaluate.tables.study", "the paper's tables 1 to 6 and figures 6, 7; ablations"),
    "null": (
        "engine.evaluate.null.study",
        "false claims: a million wrong keys, foreign marks, hostile suspects",
    ),
    "steganalysis": ("engine.evaluate.steganalysis.study", "can it be seen that there is a mark?"),
    "baselines": ("engine.evaluate.baselines.study", "other methods on the same scenes and attacks"),
    "cost": ("engine.evaluate.cost.study", "time and memory from 10 thousand to 4 million Gaussians"),
    "perceptual": (
        "engine.evaluate.perceptual.study",
        "what eyes may notice: PSNR, SSIM, MS-SSIM, FLIP, LPIPS",
    ),
}
"""Module and summary of each; the module holds `STUDY`."""


def find_study(name: str) -> Study:
    """The study of that name."""
    if name not in STUDIES:
        raise InputError(f"there is no suite {name!r}; there are {', '.join(STUDIES)}")
    study: Study = importlib.import_module(STUDIES[name][0]).STUDY
    return study
