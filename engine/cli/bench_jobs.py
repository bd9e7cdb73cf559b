"""What `mark3dgs bench` can measure: each entry takes a job and gives back rows."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from engine.evaluate.marked_scene import MarkedScene


@dataclass(frozen=True)
class Job:
    """What to measure on, and how thoroughly.

    Parameters
    ----------
    scenes : list of Path
    profile : str
        Of the embeddings.
    repeats : int
        Timed runs.
    trials : int
        Random pictures or keys.
    size : (int, int)
        Width and height of rastered images, pixels.
    seed : int
    advance : callable
        Told the fraction done.
    """

    scenes: list[Path]
    profile: str
    repeats: int
    trials: int
    size: tuple[int, int]
    seed: int
    advance: Callable[[float], None]

    def marked(self) -> Iterator[MarkedScene]:
        """Every scene, marked; tells how many are done."""
        from engine.evaluate.marked_scene import mark_scene
        from engine.pipeline.profiles import profile

        for number, path in enumerate(self.scenes):
            yield mark_scene(path, profile(self.profile), seed=self.seed)
            self.advance((number + 1) / len(self.scenes))


def _raster(job: Job) -> dict[str, Any]:
    from engine.evaluate.bench_raster import bench_raster
    from engine.formats import read_model

    rows = []
    for number, path in enumerate(job.scenes):
        measured = bench_raster(read_model(path).model, *job.size, job.repeats)
        rows.append({"scene": path.name, **measured})
        job.advance((number + 1) / len(job.scenes))
    return {"repeats": job.repeats, "rows": rows}


def _embed(job: Job) -> dict[str, Any]:
    from engine.evaluate.bench_embed import bench_embed

    return bench_embed(job.scenes, job.profile, job.repeats, job.seed, job.advance)


def _verify(job: Job) -> dict[str, Any]:
    from engine.evaluate.bench_verify import bench_verify

    return bench_verify(job.scenes, job.profile, job.repeats, job.seed, job.advance)


def _attacks(job: Job) -> dict[str, Any]:
    from engine.evaluate.bars_images import bench_image_attacks
    from engine.evaluate.bars_models import bench_model_attacks

    rows: list[dict[str, Any]] = []
    for scene in job.marked():
        rows += bench_model_attacks(scene, job.seed)
        rows += bench_image_attacks(scene, seed=job.seed)
    return {"profile": job.profile, "rows": rows}


def _screenshots(job: Job) -> dict[str, Any]:
    from engine.evaluate.bars_images import bench_screenshots

    rows: list[dict[str, Any]] = []
    for scene in job.marked():
        rows += bench_screenshots(scene, job.trials, job.seed)
    return {"profile": job.profile, "trials": job.trials, "rows": rows}


BENCHES: dict[str, Callable[[Job], dict[str, Any]]] = {
    "raster": _raster,
    "embed": _embed,
    "verify": _verify,
    "attacks": _attacks,
    "screenshots": _screenshots,
}
