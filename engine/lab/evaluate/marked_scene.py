"""A marked scene to measure on: original, marked model and opened record, made with a key of its own."""

import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

from engine.errors import InputError
from engine.flows.embed.embedding import embed_copies
from engine.flows.embed.profiles import EmbedConfig, Settings, profile
from engine.flows.records.opened_record import OpenedRecord, open_record
from engine.formats import read_model
from engine.model import GaussianModel
from engine.watermark.keys import OwnerKey
from engine.watermark.rates import MADE_FIRST

if TYPE_CHECKING:
    from _typeshed import DataclassInstance

T = TypeVar("T", bound="DataclassInstance")
Changes = Mapping[str, "bool | int | float | str | Sequence[float] | Changes | None"]
"""Fields of a configuration that differ, as plain values, nested as its stages are."""


@dataclass(frozen=True, eq=False)
class MarkedScene:
    """What every measurement starts from."""

    name: str
    original: GaussianModel
    marked: GaussianModel
    opened: OpenedRecord
    report: Mapping[str, Any]


def bench_key(seed: int) -> OwnerKey:
    """A reproducible key for measurements; never for real use."""
    return OwnerKey(hashlib.sha256(f"mark3dgs bench key {seed}".encode()).digest())


def mark_scene(path: str | Path, config: Settings, *, bits: int = 32, seed: int = 0) -> MarkedScene:
    """Read a model and mark it; the record makes the round trip through its bytes."""
    return mark_copies(path, config, [""], bits=bits, seed=seed)[0]


def mark_copies(
    path: str | Path, config: Settings, names: Sequence[str], *, bits: int = 32, seed: int = 0
) -> list[MarkedScene]:
    """The same for the copy of each recipient."""
    loaded, key = read_model(path), bench_key(seed)
    scenes = []
    for made in embed_copies(loaded.model, key, names, original_sha256=loaded.sha256, bits=bits, config=config):
        opened = open_record(made.record.to_bytes(key), key, MADE_FIRST)
        scenes.append(MarkedScene(Path(path).name, loaded.model, made.model, opened, made.report))
    return scenes


def configure(start: str, *changes: Changes) -> EmbedConfig:
    """A profile with changes as plain values, nested as its stages are; InputError for an unknown field."""
    config = profile(start)
    for change in changes:
        config = _changed(config, change)
    return config


def _changed(config: T, changes: Changes) -> T:
    known = {f.name for f in fields(config)}
    values = {}
    for name, value in changes.items():
        if name not in known:
            raise InputError(f"{type(config).__name__} has no field {name!r}; it has {', '.join(sorted(known))}")
        if isinstance(value, Mapping):
            value = _changed(getattr(config, name), value)
        values[name] = tuple(value) if isinstance(value, list) else value
    return replace(config, **values)
