"""What an attack is: a pure function with a named strength, in one or two readings of the literature.

A module of attacks declares each where it is written, and `engine.lab.sim.attacks` gathers the modules:

    ATTACKS: Attacks[Float32] = Attacks("image")

    @ATTACKS.add("multiply and clip", "factor", 1.5, (0.9, 1.1, 0.5, 1.5), "[0, inf)")
    def brightness(image, strength, rng): ...
"""

import re
from collections.abc import Callable, Sized
from dataclasses import dataclass, replace
from typing import Any, Generic, Literal, TypeVar, cast

import numpy as np

from engine.errors import InputError

Strength = float | str
"""A number, but for attacks whose strength is a name: a format, a rule, a viewer's mistake."""

Label = Literal["literal", "as_code"]
"""`literal`: as the papers word it. `as_code`: as public code runs it."""

ANY = "(-inf, inf)"

T = TypeVar("T", bound=Sized)
F = TypeVar("F", bound=Callable[..., Any])


@dataclass(frozen=True)
class Reading:
    """One way to carry an attack out."""

    # `(target, strength, rng, **options) -> target`; pure, and a function of its arguments alone. Of a picture it
    # may return any numbers (H, W, 3): they are clipped to float32 in 0..1 for it.
    function: Callable[..., Any]
    meaning: str  # unit and meaning of the strength, one line
    default: Strength  # the strength that papers quote
    grid: tuple[Strength, ...]  # strengths for curves, from harmless to ruinous
    within: str = ANY  # an interval such as "[0, 1)", or "1..100" for whole numbers; of numbers alone
    label: Label = "literal"

    def checked(self, strength: Strength) -> Strength:
        """A number as a float, or an int where it is whole; InputError where it is out of range."""
        if isinstance(strength, str):
            return strength  # the function knows its words
        whole = ".." in self.within
        low, high = (float(end) for end in re.split(r"\.\.|, ", self.within.strip("[()]")))
        at_end = (strength == low and "(" not in self.within) or (strength == high and ")" not in self.within)
        if not (low < strength < high or at_end) or (whole and not float(strength).is_integer()):
            needed = f"be a whole number from {low:g} to {high:g}" if whole else f"lie in {self.within}"
            raise InputError(f"{self.meaning} must {needed}, got {strength}")
        return int(strength) if whole else float(strength)


@dataclass(frozen=True)
class Attack(Generic[T]):
    """A named attack on models (`T` = GaussianModel) or images (`T` = float32 array (H, W, 3))."""

    name: str
    kind: Literal["model", "image"]
    summary: str  # what happens, one line
    readings: tuple[Reading, ...]  # the first is the default

    def reading(self, label: str | None = None) -> Reading:
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
        """Carry the attack out on a model or a picture (H, W, 3) float32, which is left as it is.

        The strength is in the unit of the reading, its default where not given; of `rng`, or its seed, comes every
        random choice: the same seed gives the same result. The reading is the attack's first one where not given.
        Options of single attacks: `other` of merge_into, `cameras` of prune_low_impact.

        A picture that comes back lies in 0..1 and may have another size. InputError if the reading does not exist, the
        strength is out of its range, or the target is empty or unfit.
        """
        chosen = self.reading(reading)
        value = chosen.default if strength is None else strength
        if isinstance(value, str) != isinstance(chosen.default, str):
            raise InputError(f"attack {self.name!r} takes as strength: {chosen.meaning}; got {value!r}")
        if len(target) == 0:
            raise InputError(f"attack {self.name!r} needs a {self.kind} that is not empty")
        if self.kind == "image":
            image: Any = target
            if image.ndim != 3 or image.shape[2] != 3 or image.size == 0:
                raise InputError(f"expected an image (H, W, 3), got shape {image.shape}")
            if image.dtype != np.float32:
                raise InputError(f"expected a float32 image from 0 to 1, got {image.dtype}")
        generator = rng if isinstance(rng, np.random.Generator) else np.random.default_rng(rng)
        result: Any = chosen.function(target, chosen.checked(value), generator, **options)
        if self.kind == "image":  # never a view of the target: clipping copies
            result = np.ascontiguousarray(np.clip(result, 0.0, 1.0), dtype=np.float32)
        return cast(T, result)


class Attacks(dict[str, Attack[T]]):
    """The attacks of one module by name, in the order in which they are written."""

    def __init__(self, kind: Literal["model", "image"]) -> None:
        super().__init__()
        self.kind = kind

    def add(
        self, summary: str, meaning: str, default: Strength, grid: tuple[Strength, ...], within: str = ANY
    ) -> Callable[[F], F]:
        """Declares a function an attack of its own name; the other parameters are those of `Attack` and `Reading`."""

        def declare(function: F) -> F:
            name = function.__name__
            self[name] = Attack(name, self.kind, summary, (Reading(function, meaning, default, grid, within),))
            return function

        return declare

    def as_code(
        self, name: str, meaning: str, default: Strength, grid: tuple[Strength, ...], within: str
    ) -> Callable[[F], F]:
        """Declares a function what public code runs under the words of an attack above."""

        def declare(function: F) -> F:
            reading = Reading(function, meaning, default, grid, within, "as_code")
            self[name] = replace(self[name], readings=(*self[name].readings, reading))
            return function

        return declare


def check_positive(value: float, what: str, *, zero: bool = False) -> float:
    """The value, when finite and positive (or zero, where allowed); InputError naming `what` otherwise."""
    if not (np.isfinite(value) and (value > 0 or (zero and value == 0))):
        raise InputError(f"{what} must be finite and {'not negative' if zero else 'positive'}, got {value}")
    return float(value)
