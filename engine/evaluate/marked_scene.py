"""A marked scene to measure on: original, marked model and opened record, made with a key of its own."""

import hashlib
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from engine.formats import read_model
from engine.model import GaussianModel
from engine.pipeline.embedding import embed
from engine.pipeline.profiles import EmbedConfig
from engine.pipeline.progress import Progress
from engine.pipeline.sealing import OpenedRecord, open_record
from engine.watermark.keys import OwnerKey


@dataclass(frozen=True, eq=False)
class MarkedScene:
    """What every measurement starts from."""

    name: str
    original: GaussianModel
    marked: GaussianModel
    opened: OpenedRecord
    report: dict[str, Any]


def bench_key(seed: int) -> OwnerKey:
    """A reproducible key for measurements; never for real use."""
    return OwnerKey(hashlib.sha256(f"mark3dgs bench key {seed}".encode()).digest())


def mark_scene(
    path: str | Path, config: EmbedConfig, *, bits: int = 32, seed: int = 0, progress: Progress | None = None
) -> MarkedScene:
    """Read a model and mark it; the record makes the round trip through its bytes."""
    loaded = read_model(path)
    key = bench_key(seed)
    result = embed(loaded.model, key, original_sha256=loaded.sha256, bits=bits, config=config, progress=progress)
    opened = open_record(result.record.to_bytes(key), key)
    return MarkedScene(Path(path).name, loaded.model, result.model, opened, result.report)
