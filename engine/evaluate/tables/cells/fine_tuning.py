"""Table 5: one setting of fine-tuning, read at every number of epochs, as `mark3dgs bench finetune` does it."""

from typing import Any

from engine.evaluate.bench.training import bench_fine_tuning
from engine.evaluate.study import Row
from engine.evaluate.tables.cells.settings import mark
from engine.evaluate.tables.setting import DEFAULT
from engine.sim.fine_tuning import SETTINGS

__all__ = ["fine_tune_scene"]


def fine_tune_scene(scene: str, setting: str, seed: int, epochs: int, size: int, changes: dict[str, Any]) -> list[Row]:
    """Table 5's readings along one training of all parameters."""
    marked = mark(scene, DEFAULT, seed, changes)
    rows = bench_fine_tuning(marked, SETTINGS[setting], epochs=epochs, size=size, seed=seed)
    return [{**row, "seed": seed, "views": len(marked.opened.cameras)} for row in rows]
