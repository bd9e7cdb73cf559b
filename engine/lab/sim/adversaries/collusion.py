"""Collusion: several recipients put their copies of one asset together (Boneh and Shaw; Wu, Trappe, Wang and Liu).

Copies of one asset differ in their marks alone, so the colluders need no registration: Gaussian i of one copy is
Gaussian i of another. The rules are the linear and order-statistic ones of H. V. Zhao et al., "Forensic analysis of
nonlinear collusion attacks for multimedia fingerprinting" (IEEE TIP 14(5), 2005), applied to every value,
and two that mix whole Gaussians.
"""

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from engine.errors import InputError
from engine.lab.sim.attack import Attacks
from engine.model import Float32, GaussianModel

ATTACKS: Attacks[GaussianModel] = Attacks("model")

_COEFFICIENTS_AT_A_TIME = 1 << 22  # of all copies: order statistics of a big scene need no big memory

_Rule = Callable[[Float32, np.random.Generator], npt.NDArray[Any]]

_VALUE_RULES: dict[str, _Rule] = {
    "mean": lambda values, rng: values.mean(axis=0, dtype=np.float64),
    "median": lambda values, rng: np.median(values, axis=0),
    "min": lambda values, rng: values.min(axis=0),
    "max": lambda values, rng: values.max(axis=0),
    "minmax": lambda values, rng: np.float32(0.5) * (values.min(axis=0) + values.max(axis=0)),
    "modneg": lambda values, rng: values.min(axis=0) + values.max(axis=0) - np.median(values, axis=0),
    "randneg": lambda values, rng: np.where(rng.random(values.shape[1:]) < 0.5, values.min(axis=0), values.max(axis=0)),
}
"""By name: values (copies, n, ...) and a source of coins to (n, ...)."""

PATCHES = 256  # connected pieces of the "patches" rule: enough that every colluder's part lies all over the scene


def _patches(model: GaussianModel, copies: int, rng: np.random.Generator) -> npt.NDArray[np.int64]:
    """(N,) source of each Gaussian; those nearest to the same random Gaussian share one."""
    from scipy.spatial import cKDTree

    count = min(PATCHES, len(model))
    seeds = model.means[rng.choice(len(model), count, replace=False)]
    patch = cKDTree(seeds).query(model.means, workers=2)[1]
    # Dealt, not drawn: with few patches every copy takes part all the same.
    return np.asarray(rng.permutation(np.arange(count) % copies)[patch])


_MIXERS: dict[str, Callable[[GaussianModel, int, np.random.Generator], npt.NDArray[np.int64]]] = {
    "interleave": lambda model, copies, rng: rng.integers(copies, size=len(model)),
    "patches": _patches,
}
"""By name: model, number of copies and a source of chance to the source of each Gaussian, (N,)."""

NEED_COPIES = ("collude", "algebra", "push")  # attacks that take `others`

FIRST = "first"  # the rule that averages colors and keeps one copy's geometry, whose owner the marks then name loudest
RULES = (*_VALUE_RULES, *_MIXERS, FIRST)  # names of the rules


@ATTACKS.add("put several copies of one asset together", "rule", "mean", RULES)
def collude(
    model: GaussianModel, strength: str, rng: np.random.Generator, *, others: Sequence[GaussianModel] = ()
) -> GaussianModel:
    """One model out of several copies; InputError where the rule is unknown, no other is given or they differ in shape.

    `strength` says what is done with the copies' values of each coefficient, center, size and opacity: "mean",
    "median", "min", "max", "minmax" (middle of the extremes), "modneg" (min + max - median), "randneg" (min or max by a
    coin); or "interleave" (each Gaussian from a random copy), "patches" (each of some hundred connected pieces from a
    random copy) and "first" (colors averaged, all else from the first copy).

    The `others` have the same Gaussians in the same order. Rotations are the same but for rounding, and are taken from
    the first, `model`.
    """
    if strength not in RULES:
        raise InputError(f"copies are put together by one of {', '.join(RULES)}, got {strength!r}")
    copies = same_shape(model, others)
    names = ("sh",) if strength == FIRST else ("means", "log_scales", "opacity_logits", "sh")
    if strength in _MIXERS:
        source = _MIXERS[strength](model, len(copies), rng)
        rows = np.arange(len(model))
        return model.with_(**{name: np.stack([getattr(c, name) for c in copies])[source, rows] for name in names})
    rule = _VALUE_RULES["mean" if strength == FIRST else strength]
    return model.with_(**{name: _combined([getattr(copy, name) for copy in copies], rule, rng) for name in names})


def same_shape(model: GaussianModel, others: Sequence[GaussianModel]) -> list[GaussianModel]:
    """The model and the other copies; InputError where no other is given or one differs in shape."""
    if not others:
        raise InputError("collusion needs the models of the other copies: others=[...]")
    for number, other in enumerate(others, start=2):
        if other.sh.shape != model.sh.shape:
            raise InputError(f"copy {number} has colors {other.sh.shape}, the first has {model.sh.shape}")
    return [model, *others]


def in_order_of(model: GaussianModel, other: GaussianModel) -> GaussianModel:
    """Another copy in the order of this one: formats sort by values that differ. The nearest center is the partner."""
    from scipy.spatial import cKDTree

    return other.take(cKDTree(other.means).query(model.means, workers=2)[1])


def _combined(copies: Sequence[Float32], rule: _Rule, rng: np.random.Generator) -> Float32:
    """One attribute (N, ...) of all copies by a rule, some rows at a time."""
    out = np.empty_like(copies[0])
    rows = max(1, _COEFFICIENTS_AT_A_TIME // (len(copies) * max(1, copies[0][0].size)))
    for start in range(0, len(out), rows):
        part = slice(start, start + rows)
        out[part] = rule(np.stack([copy[part] for copy in copies]), rng)
    return out
