"""What `mark3dgs bench` can measure: each entry takes a job and gives back rows."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from engine.evaluate.marked_scene import MarkedScene
    from engine.model import GaussianModel


SCREENSHOTS, EPOCHS, WRONG_KEYS = 50, 500, 100_000
"""How many trials those benches run unless told otherwise."""


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
    trials : int or None
        Random pictures, epochs or wrong keys; None for what the bars ask.
    size : (int, int)
        Width and height of rastered images, pixels.
    seed : int
    advance : callable
        Told the fraction done.
    settings : list of str
        Of Table 5, for fine-tuning; all four when empty.
    colors_only : bool
        Fine-tuning leaves the geometry alone.
    """

    scenes: list[Path]
    profile: str
    repeats: int
    trials: int | None
    size: tuple[int, int]
    seed: int
    advance: Callable[[float], None]
    settings: list[str] = field(default_factory=list)
    colors_only: bool = False

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


def _fidelity(job: Job) -> dict[str, Any]:
    from engine.evaluate.bars_fidelity import bench_fidelity

    rows: list[dict[str, Any]] = []
    for number, path in enumerate(job.scenes):
        rows += bench_fidelity(path, job.profile, job.seed)
        job.advance((number + 1) / len(job.scenes))
    return {"profile": job.profile, "rows": rows}


def _attacks(job: Job) -> dict[str, Any]:
    from engine.evaluate.bars_images import bench_image_attacks
    from engine.evaluate.bars_models import bench_model_attacks

    rows: list[dict[str, Any]] = []
    for scene in job.marked():
        rows += bench_model_attacks(scene, job.seed)
        rows += bench_image_attacks(scene, seed=job.seed)
    return {"profile": job.profile, "rows": rows}


def _screenshots(job: Job) -> dict[str, Any]:
    """Own screenshots of every scene; with several scenes, also a fifth as many of the next one."""
    from engine.evaluate.bars_images import bench_screenshots

    trials = job.trials or SCREENSHOTS
    rows: list[dict[str, Any]] = []
    for number, scene in enumerate(job.marked()):
        own = bench_screenshots(scene, trials, job.seed)
        rows += [{"source": "own", **row} for row in own]
        if len(job.scenes) > 1:
            other = job.scenes[(number + 1) % len(job.scenes)]
            foreign = bench_screenshots(scene, -(-trials // 5), job.seed, foreign=partial(_model_at, other))
            rows += [{"source": other.name, **row} for row in foreign]
    return {"profile": job.profile, "trials": trials, "rows": rows}


def _model_at(path: Path) -> GaussianModel:
    from engine.formats import read_model

    return read_model(path).model


def _fine_tuning(job: Job) -> dict[str, Any]:
    from engine.errors import InputError
    from engine.evaluate.bars_fine_tuning import bench_fine_tuning
    from engine.sim.fine_tuning import SETTINGS

    if unknown := [name for name in job.settings if name not in SETTINGS]:
        raise InputError(f"Table 5 has no setting {unknown[0]!r}; it has {', '.join(SETTINGS)}")
    epochs = job.trials or EPOCHS
    wanted = job.settings or list(SETTINGS)
    rows: list[dict[str, Any]] = []
    for scene in job.marked():
        for name in wanted:
            rows += bench_fine_tuning(
                scene, SETTINGS[name], epochs=epochs, seed=job.seed,
                trained="colors" if job.colors_only else "all", advance=job.advance,
            )  # fmt: skip
    return {"profile": job.profile, "epochs": epochs, "rows": rows}


def _truth(job: Job) -> dict[str, Any]:
    """Wrong keys on every scene, every record against every other scene, and a forged original for each."""
    from engine.evaluate.bars_truth import cross_check, forge, wrong_key_rates
    from engine.pipeline.profiles import profile

    keys = job.trials or WRONG_KEYS
    scenes = list(job.marked())
    wrong = [row for scene in scenes for row in wrong_key_rates(scene, keys, job.seed)]
    crossed = cross_check(scenes, [(scene.name, scene.original) for scene in scenes])
    forged = [forge(scene, profile(job.profile)) for scene in scenes]
    kinds = {"wrong keys": wrong, "cross check": crossed, "forged original": forged}
    rows = [{"check": kind, **row} for kind, found in kinds.items() for row in found]
    return {"profile": job.profile, "keys": keys, "rows": rows}


BENCHES: dict[str, Callable[[Job], dict[str, Any]]] = {
    "raster": _raster,
    "embed": _embed,
    "verify": _verify,
    "fidelity": _fidelity,
    "attacks": _attacks,
    "screenshots": _screenshots,
    "finetune": _fine_tuning,
    "truth": _truth,
}
