"""Chains of attacks on a marked model and on pictures of it, with whose they are. The list is in `suite.toml`."""

import tomllib
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np

from engine.lab.sim.adversaries.collusion import NEED_COPIES
from engine.lab.sim.attack import Label, Strength
from engine.lab.sim.attacks import image_attack, model_attack
from engine.model import Float32, GaussianModel

Step = tuple[str, Strength]
"""Name and strength of an attack of the registry."""

WITHOUT_COST = {"merge_into", "crop_image", "rotate_image", "scale_image"}
"""Steps that only move, cut or surround what is stolen: left out when the look is judged."""


@dataclass(frozen=True)
class Trial:
    """One line of the suite."""

    label: str
    chain: tuple[Step, ...]  # attacks in order, each by name and strength
    source: str  # whose attack it is: the work in which it, or its strength, stands
    kind: Literal["model", "image"] = "model"  # what is attacked
    reading: Label = "literal"  # of all steps that have it; the others run literally


def _read_suite() -> tuple[Trial, ...]:
    tables = tomllib.loads(Path(__file__).with_suffix(".toml").read_text(encoding="utf-8"))
    trials = []
    for row in tables["suite"]["trials"]:
        chain = tuple((name, strength) for name, strength in row["chain"])
        trials.append(Trial(**{**row, "source": tables["sources"][row["source"]], "chain": chain}))
    return tuple(trials)


SUITE = _read_suite()
"""All trials, in the order of a table: placed, cut and added to, changed in value, attacked on purpose, chains,
pictures."""


def apply_chain(
    target: GaussianModel | Float32,
    trial: Trial,
    seed: int | Sequence[int],
    *,
    others: Sequence[GaussianModel] = (),
    skip: Iterable[str] = (),
) -> Any:
    """The model, or picture (H, W, 3), after all steps of a trial, each with a random stream of its own.

    Collusion takes `others`, further recipients' copies. Attacks in `skip` are left out; the others keep their streams.
    """
    find = image_attack if trial.kind == "image" else model_attack
    for number, (name, strength) in enumerate(trial.chain):
        if name in skip:
            continue
        attack: Any = find(name)
        options = {"others": others} if name in NEED_COPIES else {}
        labels = [reading.label for reading in attack.readings]
        reading = trial.reading if trial.reading in labels else None
        rng = np.random.default_rng((seed, number))
        target = attack.apply(target, strength, rng=rng, reading=reading, **options)
    return target
