"""The settings that are compared: one knob at a time around the profile `fast`, and the corners that matter."""

from dataclasses import dataclass, field
from typing import Any

from engine.flows.embed.profiles import AUTO, EmbedConfig
from engine.lab.evaluate.marked_scene import Changes, configure

NESTED = {"cells": ("quantize", "cells"), "budget": ("prune", "budget_db")}
"""Short names of knobs that belong to a stage of the embedding."""


@dataclass(frozen=True)
class Point:
    """One setting, as plain values that a cell can carry; the axis says what is varied."""

    name: str
    axis: str
    profile: str = "fast"
    """Where it starts from; AUTO leaves it to `engine.flows.embed.auto_profile`."""
    changes: Changes = field(default_factory=dict)
    """Knobs of EmbedConfig, and those of NESTED."""
    bits: int = 32
    degree: int | None = None
    """SH degree the model is cut to before; None leaves it."""

    @property
    def shares_landmarks(self) -> bool:
        """Whether its landmark bank is the base's: the bank follows from the delivered, unmarked model alone."""
        keeps_model = all(name not in ("budget", "output", "landmark_views") for name in self.changes)
        return keeps_model and self.degree is None and self.profile != AUTO and self != BASE


def _axis(axis: str, knob: str, values: tuple[Any, ...]) -> list[Point]:
    return [Point(f"{axis.replace(' ', '-')}-{value}", axis, changes={knob: value}) for value in values]


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
            Point("auto", "auto", AUTO),
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
        Point("leanest", "corner", changes={"landmark_views": 16, "view_size": 400, "views": 4}),
        Point("smallest", "corner", changes={"budget": 35.0, "output": "compact"}),
        Point("hardest", "corner", "strong", {"cells": 16384}),
        Point("finest", "corner", changes={"cells": 16384, "psnr_db": 53.0}, bits=256),
        Point("auto", "auto", AUTO),
        *(Point(f"allowed-{db:g}", "allowance", AUTO, {"budget": db}) for db in (45.0, 40.0, 35.0, 30.0)),
    ]


def config_of(point: Point, **more: Any) -> EmbedConfig:
    """Settings of a point, `more` on top; of `auto`, those that the choice starts from."""
    changes = {**point.changes, **more}
    deep: dict[str, Changes] = {}
    for name, (stage, knob) in NESTED.items():
        if name in changes:
            deep[stage] = {knob: changes.pop(name)}
    return configure(BASE.profile if point.profile == AUTO else point.profile, changes, deep)
