"""The settings that are compared: one knob at a time around the profile `fast`, and the corners that matter."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from engine.pipeline.profiles import EmbedConfig

__all__ = ["BASE", "Point", "config_of", "points"]


@dataclass(frozen=True)
class Point:
    """One setting, as plain values.

    Parameters
    ----------
    name : str
        For cells and figures.
    axis : str
        What is varied: profile, bits, views, view size, cells, SH degree, pruning, fidelity, landmarks, corner, auto.
    profile : str
        Where it starts from; "auto" leaves it to `engine.pipeline.choosing`.
    changes : tuple of (str, value)
        Knobs of EmbedConfig, and `cells` (of the quantiser), `budget` (dB, of pruning).
    degree : int or None
        SH degree the model is cut to before; None leaves it.
    """

    name: str
    axis: str
    profile: str = "fast"
    changes: tuple[tuple[str, Any], ...] = ()
    bits: int = 32
    degree: int | None = None

    def arguments(self) -> dict[str, Any]:
        """As a cell's JSON argument; `Point.make` reads it."""
        return {**asdict(self), "changes": dict(self.changes)}

    @staticmethod
    def make(values: dict[str, Any]) -> Point:
        """Back from JSON."""
        return Point(**{**values, "changes": tuple(sorted(values["changes"].items()))})

    @property
    def shares_landmarks(self) -> bool:
        """Whether its landmark bank is the base's: the bank follows from the delivered, unmarked model alone."""
        keeps_model = all(name not in ("budget", "output", "landmark_views") for name, _ in self.changes)
        return keeps_model and self.degree is None and self.profile != "auto" and self != BASE


def _axis(axis: str, knob: str, values: tuple[Any, ...]) -> list[Point]:
    return [Point(f"{axis.replace(' ', '-')}-{value}", axis, changes=((knob, value),)) for value in values]


BASE = Point("fast", "profile")
"""The profile around which one knob is changed at a time."""


def points(quick: bool) -> list[Point]:
    """All settings of a study, the base first.

    A quick study has the base and three others, on small views and without landmarks (`measure_point` sees to it).
    """
    if quick:
        return [
            BASE,
            *_axis("cells", "cells", (1024,)),
            *_axis("fidelity", "psnr_db", (53.0,)),
            Point("auto", "auto", "auto"),
        ]
    return [
        BASE,
        Point("balanced", "profile", "balanced"),
        Point("strong", "profile", "strong"),
        *(Point(f"bits-{bits}", "bits", bits=bits) for bits in (16, 64, 128, 256)),
        *_axis("views", "views", (2, 4, 16)),
        *_axis("view size", "view_size", (256, 400)),
        *_axis("cells", "cells", (1024, 2048, 4096, 16384)),
        *(Point(f"SH-{degree}", "SH degree", degree=degree) for degree in (0, 1, 2)),
        *_axis("pruning", "budget", (45.0, 40.0, 35.0, 30.0)),
        *_axis("fidelity", "psnr_db", (44.0, 50.0, 53.0)),
        *_axis("landmarks", "landmark_views", (0, 16, 24)),
        Point("leanest", "corner", changes=(("landmark_views", 16), ("view_size", 400), ("views", 4))),
        Point("smallest", "corner", changes=(("budget", 35.0), ("output", "compact"))),
        Point("hardest", "corner", "strong", (("cells", 16384),)),
        Point("finest", "corner", changes=(("cells", 16384), ("psnr_db", 53.0)), bits=256),
        Point("auto", "auto", "auto"),
    ]


def config_of(point: Point, **more: Any) -> EmbedConfig:
    """Settings of a point, `more` on top; of `auto`, those that the choice starts from."""
    from dataclasses import replace

    from engine.pipeline.choosing import AUTO, START
    from engine.pipeline.profiles import profile

    changes = dict(point.changes) | more
    cells, budget = changes.pop("cells", None), changes.pop("budget", None)
    config = profile(START if point.profile == AUTO else point.profile, **changes)
    if cells is not None:
        config = replace(config, quantize=replace(config.quantize, cells=cells))
    if budget is not None:
        config = replace(config, prune=replace(config.prune, budget_db=budget))
    return config
