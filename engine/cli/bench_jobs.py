"""What `mark3dgs bench` can measure: each entry takes a job and gives back rows."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from engine.evaluate.marked_scene import MarkedScene
    from engine.model import GaussianModel


SCREENSHOTS, EPOCHS, WRONG_KEYS, INNOCENTS = 50, 500, 100_000, 10_000
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
        Random pictures, epochs, wrong keys or innocent copies; None for what the bars ask.
    size : (int, int)
        Width and height of rastered images, pixels.
    advance : callable
        Told the fraction done.
    settings : list of str
        Of Table 5, for fine-tuning, or variants of Table 4; all when empty.
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
    from engine.evaluate.bars_fine_tuning import bench_fine_tuning
    from engine.sim.fine_tuning import SETTINGS

    epochs = job.trials or EPOCHS
    wanted = _chosen(job.settings, SETTINGS, "Table 5")
    rows: list[dict[str, Any]] = []
    for scene in job.marked():
        for name in wanted:
            rows += bench_fine_tuning(
                scene,
                SETTINGS[name],
                epochs=epochs,
                seed=job.seed,
                trained="colors" if job.colors_only else "all",
                advance=job.advance,
            )
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


def _chosen(names: list[str], known: Collection[str], table: str) -> list[str]:
    from engine.errors import InputError

    if unknown := [name for name in names if name not in known]:
        raise InputError(f"{table} has no setting {unknown[0]!r}; it has {', '.join(known)}")
    return names or list(known)


def _variants(job: Job) -> dict[str, Any]:
    """Table 4: every scene as every variant."""
    from engine.evaluate.bars_variants import VARIANTS, bench_variant

    wanted = _chosen(job.settings, VARIANTS, "Table 4")
    rows = []
    for path in job.scenes:
        for kind in wanted:
            rows.append(bench_variant(kind, path, job.seed))
            job.advance(len(rows) / (len(job.scenes) * len(wanted)))
    return {"rows": rows}


def _suite(job: Job) -> dict[str, Any]:
    """Every attack of the list on every scene; the next scene, or the shipped one, is merged into and framed."""
    from engine.cli.models import shipped_scene
    from engine.evaluate.bars_suite import bench_suite

    rows: list[dict[str, Any]] = []
    for path, after in zip(job.scenes, [*job.scenes[1:], job.scenes[0]], strict=True):
        other = after if after != path else shipped_scene()
        model = None if other.name == path.name else _model_at(other)
        rows += bench_suite(path, job.profile, other=model, seed=job.seed, advance=job.advance)
    return {"profile": job.profile, "rows": rows}


def _collusion(job: Job) -> dict[str, Any]:
    from engine.evaluate.bars_collusion import bench_collusion

    innocents = job.trials or INNOCENTS
    rows: list[dict[str, Any]] = []
    for path in job.scenes:
        rows += bench_collusion(path, innocents=innocents, seed=job.seed, advance=job.advance)
    return {"innocents": innocents, "rows": rows}


def _retraining(job: Job) -> dict[str, Any]:
    from engine.evaluate.bars_retraining import bench_retraining

    rows: list[dict[str, Any]] = []
    for scene in job.marked():
        rows += bench_retraining(scene, seed=job.seed, advance=job.advance)
    return {"profile": job.profile, "rows": rows}


def _life(job: Job) -> dict[str, Any]:
    from engine.evaluate.bench_life import bench_physics, bench_training

    rows = []
    for path in job.scenes:
        rows.append({"what": "physics", **bench_physics(path, job.repeats, job.seed)})
        rows.append({"what": "training", **bench_training(path, job.repeats, job.seed)})
        job.advance(len(rows) / (2 * len(job.scenes)))
    return {"rows": rows}


BENCHES: dict[str, Callable[[Job], dict[str, Any]]] = {
    "raster": _raster,
    "embed": _embed,
    "verify": _verify,
    "fidelity": _fidelity,
    "attacks": _attacks,
    "screenshots": _screenshots,
    "finetune": _fine_tuning,
    "truth": _truth,
    "suite": _suite,
    "variants": _variants,
    "collusion": _collusion,
    "retrain": _retraining,
    "life": _life,
}
