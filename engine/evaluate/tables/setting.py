"""One way to set the engine up: what is changed against the profile, as plain values, so that cells can carry it."""

from __future__ import annotations

from dataclasses import asdict, dataclass, field, fields, is_dataclass, replace
from typing import TYPE_CHECKING, Any, TypeVar

from engine.errors import InputError

if TYPE_CHECKING:
    from engine.pipeline.profiles import EmbedConfig

__all__ = ["DEFAULT", "PROFILE", "Setting", "configure"]

PROFILE = "fast"
"""Profile that every setting starts from: the cheapest one, so nothing shown here needs more."""

T = TypeVar("T")


@dataclass(frozen=True)
class Setting:
    """A row of an ablation, a point of a curve.

    Parameters
    ----------
    name : str
        Unique among all tables; part of the cells' names.
    changes : dict
        Fields of `EmbedConfig` to other values, nested as its stages are.
    without : str
        A step to take out that has no knob (see `engine.evaluate.tables.without`).
    unmarked : bool
        Look at the unmarked original in place of the marked model.
    """

    name: str
    changes: dict[str, Any] = field(default_factory=dict)
    without: str = ""
    bits: int = 32
    unmarked: bool = False

    def to_json(self) -> dict[str, Any]:
        """Argument of a cell."""
        return asdict(self)


DEFAULT = Setting("default")
"""The profile as it is, 32 bits."""


def configure(*changes: dict[str, Any]) -> EmbedConfig:
    """The profile, without a landmark bank (cameras are given), with changes; InputError for an unknown field."""
    from engine.pipeline.profiles import profile

    config = profile(PROFILE, landmark_views=0)
    for change in changes:
        config = _changed(config, change)
    return config


def _changed(config: T, changes: dict[str, Any]) -> T:
    assert is_dataclass(config)
    known = {f.name for f in fields(config)}
    values = {}
    for name, value in changes.items():
        if name not in known:
            raise InputError(f"{type(config).__name__} has no field {name!r}; it has {', '.join(sorted(known))}")
        if isinstance(value, dict):
            value = _changed(getattr(config, name), value)
        values[name] = tuple(value) if isinstance(value, list) else value
    return replace(config, **values)  # type: ignore[type-var]
