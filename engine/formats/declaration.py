"""What a model format declares: how its files are recognized, read and written, and what they cannot hold."""

from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from functools import partial
from importlib import import_module
from pathlib import Path
from typing import Any, Literal

import numpy as np

from engine.formats.repairs import Repair
from engine.model import Bool, Float32, Float64, GaussianModel

Read = tuple[GaussianModel, tuple[Repair, ...]]
Held = Literal["harmonics", "discs", "antialiasing", "properties", "comments", "origin"]


@dataclass(frozen=True)
class Range:
    """What a format holds of an attribute, and in which steps, in the units of the values."""

    name: Literal["colors", "harmonics", "sizes"]  # coefficients of degree 0, those beyond, logarithms of scales
    low: float
    high: float
    step: float  # twice what it rounds by within its range

    def beyond(self, model: GaussianModel) -> Bool:
        """(N,) which Gaussians are clipped by more than rounding."""
        found = {"colors": model.sh[:, 0], "harmonics": model.sh[:, 1:], "sizes": model.log_scales}[self.name]
        values = found.reshape(len(model), -1)
        low, high = self.low - self.step / 2, self.high + self.step / 2  # of either sign
        return np.asarray((values.min(axis=1, initial=0) < low) | (values.max(axis=1, initial=0) > high))


@dataclass(frozen=True)
class Place:
    """What counts besides the content of a file."""

    spz_frame: str = "auto"  # axes of an SPZ file
    folder: Path | None = None  # whose files it may name
    opened: list[Path] = field(default_factory=list)  # of these, those that were read


@dataclass(frozen=True)
class Kind:
    """One format; its name is also the ending of its files. `file` is what messages call the file."""

    name: str
    told_by: Callable[[bytes, str], bool]  # (content, file) -> whether this is one
    read: Callable[[bytes, str, Place], Read]
    # model of at least one Gaussian -> pieces of the file; None for a format that is only read
    write: Callable[[GaussianModel], Iterable[bytes]] | None = None
    guessed: bool = False  # without a magic: recognized after all formats that have one
    endings: tuple[str, ...] = ()  # of files that are written, beside its name
    load: Callable[[str], object] | None = None  # packages that are not always installed, for a purpose in words

    # what a written file holds beside means, scales, rotations, opacities and color, and how
    holds: tuple[Held, ...] = ()
    ranges: tuple[Range, ...] = ()
    rounded: Callable[[Float32], Float64] | None = None  # means as the file holds them, if one range is for many rows
    colors: Callable[[GaussianModel], Float64] | None = None  # those of degree 0 as the file holds them, likewise
    step: Callable[[Float64], float] | None = None  # of means (N, 3) in such a range, scene units


def later(module: str) -> Callable[[], Any]:
    """What loads a module when it is called: those that decode a format are loaded only in order to decode."""
    return partial(import_module, module)
