"""Table 4: one variant made from a scene, marked, attacked and read, as `mark3dgs bench variants` does it."""

from pathlib import Path

from engine.evaluate.bench.marking import bench_variant
from engine.evaluate.study import Row

__all__ = ["measure_variants"]


def measure_variants(scene: str, kind: str, seed: int) -> list[Row]:
    """One row of Table 4, of a scene as one kind of model; takes one to two minutes on 100k Gaussians."""
    return [{"model": kind, **bench_variant(kind, Path(scene), seed)}]
