"""The suites of `mark3dgs evaluate`, by name; a module is imported when its study is used."""

import importlib

from engine.errors import InputError
from engine.lab.evaluate.measurements import MEASUREMENTS
from engine.lab.evaluate.study import Study

STUDIES = {
    "pareto": "speed against accuracy, and what a scene needs",
    "stability": "every attack from harmless to ruinous; odd inputs",
    "tables": "the paper's tables 1 to 6 and figures 6, 7; ablations; --setting chooses among them",
    "null": "false claims: a million wrong keys, foreign marks, hostile suspects",
    "steganalysis": "can a detector see that there is a watermark?",
    "cost": "time and memory from 10 thousand to 10 million Gaussians",
    "perceptual": "what eyes may notice: PSNR, SSIM, MS-SSIM, FLIP, LPIPS",
}
"""Summary of each study with bars and figures; `engine.lab.evaluate.NAME.NAME_study` holds it as `STUDY`."""


PROTOCOLS = {
    "benchmark": "every attack of the simulator on a method's mark, ours or yours (--method)",
    "flymark": "FlyMark's ten families of attacks on models",
    "msvs": "pictures from concentric shells all around a model",
}
"""The same of the protocols that compare methods; `engine.lab.evaluate.benchmark.NAME` holds it."""


def summaries() -> dict[str, str]:
    """One line for each suite."""
    return STUDIES | PROTOCOLS | {name: measurement.summary for name, measurement in MEASUREMENTS.items()}


def find_study(name: str) -> Study:
    """The suite of this name; InputError where there is none."""
    if name in MEASUREMENTS:
        return MEASUREMENTS[name].study(name)
    if name not in summaries():
        raise InputError(f"there is no suite {name!r}; there are {', '.join(summaries())}")
    module = f"benchmark.{name}" if name in PROTOCOLS else f"{name}.{name}_study"
    study: Study = importlib.import_module(f"engine.lab.evaluate.{module}").STUDY
    return study
