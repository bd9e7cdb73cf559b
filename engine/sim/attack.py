"""What an attack is: a pure function with a named strength, in one or two readings of the literature."""

from collections.abc import Callable, Sized
from dataclasses import dataclass
from typing import Any, Generic, Literal, TypeVar

import numpy as np

from engine.errors import InputError

__all__ = ["Attack", "Label", "Reading", "Strength", "check_fraction", "check_positive"]

Strength = float | str
"""A number for every attack but `convert`, whose strength is the name of a format."""

Label = Literal["literal", "as_code"]
"""`literal`: what the words of the papers say. `as_code`: what public code executes under those words."""

T = TypeVar("T", bound=Sized)


@dataclass(frozen=True)
class Reading(Generic[T]):
    """One way to carry an attack out.

    Parameters
    ----------
    function : callable
        `(target, strength, rng, **options) -> target`; pure, and a function of its arguments alone.
    meaning : str
        Unit and meaning of the strength, one line.
    default : float or str
        The strength that papers quote.
    grid : tuple of float or str
        Strengths for curves, from harmless to ruinous.
    label : {"literal", "as_code"}
    """

    function: Callable[..., T]
    meaning: str
    default: Strength
    grid: tuple[Strength, ...]
    label: Label = "literal"


@dataclass(frozen=True)
class Attack(Generic[T]):
    """A named attack on models (`T` = GaussianModel) or images (`T` = float32 array (H, W, 3)).

    Parameters
    ----------
    kind : {"model", "image"}
    summary : str
        What happens, one line.
    readings : tuple of Reading
        The first is the default.
    """

    name: str
    kind: Literal["model", "image"]
    summary: str
    readings: tuple[Reading[T], ...]

    def reading(self, label: str | None = None) -> Reading[T]:
        """The reading of that label, the default one for None; InputError when there is none."""
        for reading in self.readings:
            if label is None or reading.label == label:
                return reading
        known = ", ".join(r.label for r in self.readings)
        raise InputError(f"attack {self.name!r} has no reading {label!r}; it has {known}")

    @property
    def meaning(self) -> str:
        """Unit and meaning of the strength in the default reading."""
        return self.readings[0].meaning

    @property
    def default(self) -> Strength:
        """Strength that papers quote, in the default reading."""
        return self.readings[0].default

    @property
    def grid(self) -> tuple[Strength, ...]:
        """Strengths from harmless to ruinous, in the default reading."""
        return self.readings[0].grid

    def apply(
        self,
        target: T,
        strength: Strength | None = None,
        *,
        rng: np.random.Generator | int = 0,
        reading: str | None = None,
        **options: Any,
    ) -> T:
        """Carry the attack out.

        Parameters
        ----------
        target : GaussianModel or (H, W, 3) float32
            Left as it is.
        strength : float or str, optional
            In the unit of the reading; its default where not given.
        rng : numpy.random.Generator or int
            Source of every random choice, or its seed; the same seed gives the same result.
        reading : {"literal", "as_code"}, optional
            The first one of the attack where not given.
        **options
            What single attacks take beside: `other` of merge_into, `cameras` of prune_low_impact, `expand` of
            rotate_image.

        Returns
        -------
        GaussianModel or (H, W, 3) float32

        Raises
        ------
        InputError
            If the reading does not exist, the strength is out of its range, or the target is empty or unfit.
        """
        chosen = self.reading(reading)
        value = chosen.default if strength is None else strength
        if isinstance(value, str) != isinstance(chosen.default, str):
            raise InputError(f"attack {self.name!r} takes as strength: {chosen.meaning}; got {value!r}")
        if len(target) == 0:
            raise InputError(f"attack {self.name!r} needs a {self.kind} that is not empty")
        generator = rng if isinstance(rng, np.random.Generator) else np.random.default_rng(rng)
        return chosen.function(target, value, generator, **options)


def check_fraction(value: float, what: str, *, zero: bool = True, one: bool = False) -> float:
    """The value, when in 0..1 (the ends only where allowed); InputError naming `what` otherwise."""
    inside = (0 < value < 1) or (zero and value == 0) or (one and value == 1)
    if not inside:
        raise InputError(f"{what} must lie in {'[' if zero else '('}0, 1{']' if one else ')'}, got {value}")
    return float(value)


def check_positive(value: float, what: str, *, zero: bool = False) -> float:
    """The value, when finite and positive (or zero, where allowed); InputError naming `what` otherwise."""
    if not (np.isfinite(value) and (value > 0 or (zero and value == 0))):
        raise InputError(f"{what} must be finite and {'not negative' if zero else 'positive'}, got {value}")
    return float(value)
