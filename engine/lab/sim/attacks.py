"""The attacks by name. Where papers and code differ, both readings stand.

Sources of the readings: the public code of GuardSplat, 3D-GSW, WateRF and GaussianMarker. One thing of theirs
is left out: 3D-GSW and WateRF cast noisy images back to 8 bit without clipping, so that white wraps to black.
"""

from collections.abc import Mapping
from typing import Any, TypeVar

from engine.errors import InputError
from engine.lab.sim import image_attacks, image_encoders, model_placement, model_population, model_values
from engine.lab.sim.adversaries import (
    algebra,
    appearance,
    collusion,
    evolution,
    lattices,
    laundering,
    purification,
    second_marks,
)
from engine.lab.sim.attack import Attack
from engine.model import Float32, GaussianModel

A = TypeVar("A")

MODEL_ATTACKS: dict[str, Attack[GaussianModel]] = {
    **model_placement.ATTACKS,
    **model_population.ATTACKS,
    **model_values.ATTACKS,
    **appearance.ATTACKS,
    **purification.ATTACKS,
    **evolution.ATTACKS,
    **collusion.ATTACKS,  # these and the next need `others`
    **algebra.ATTACKS,
    **lattices.ATTACKS,
    **laundering.ATTACKS,
    **second_marks.ATTACKS,  # `transplant` needs `source`
}
"""Attacks on models, by name."""

IMAGE_ATTACKS: dict[str, Attack[Float32]] = {**image_attacks.ATTACKS, **image_encoders.ATTACKS}
"""Attacks on images, by name."""


def model_attack(name: str) -> Attack[GaussianModel]:
    """The attack on models of that name; InputError with the known names when there is none."""
    return _named(name, MODEL_ATTACKS)


def image_attack(name: str) -> Attack[Float32]:
    """The attack on images of that name; InputError with the known names when there is none."""
    return _named(name, IMAGE_ATTACKS)


def find_attack(name: str) -> Attack[Any]:
    """The attack of that name, of either kind; InputError with the known names when there is none."""
    return _named(name, {**MODEL_ATTACKS, **IMAGE_ATTACKS})


def _named(name: str, known: Mapping[str, A]) -> A:
    if name not in known:
        raise InputError(f"no attack is called {name!r}; there are {', '.join(known)}")
    return known[name]
