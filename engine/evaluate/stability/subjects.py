"""What is attacked: a scene marked anew for every trial, by us and by the baselines, made once for each process."""

from dataclasses import dataclass
from functools import lru_cache

from engine.evaluate.baselines.methods import METHODS, Kept
from engine.evaluate.marked_scene import MarkedScene, bench_key, mark_scene
from engine.model import Float64, GaussianModel
from engine.pipeline.profiles import EmbedConfig, profile

__all__ = ["BASELINES", "BaselineMark", "Subjects", "subjects"]

BASELINES = ("qim", "spread")
"""Those that read models: their marks are there at once."""


@dataclass(frozen=True, eq=False)
class BaselineMark:
    """A scene marked by another method with the same message, at the same PSNR in the same views."""

    name: str
    model: GaussianModel
    kept: Kept

    def read(self, suspect: GaussianModel) -> Float64 | None:
        """(B,) scores of a suspect, whose signs are the bits."""
        return METHODS[self.name].read_model(suspect, self.kept)


@dataclass(frozen=True, eq=False)
class Subjects:
    """One marked scene for each trial, each under a key of its own; the baselines' marks of the first trial.

    Parameters
    ----------
    trials : tuple of MarkedScene
    baselines : tuple of BaselineMark
    """

    trials: tuple[MarkedScene, ...]
    baselines: tuple[BaselineMark, ...]


def config_of(quick: bool) -> EmbedConfig:
    """Profile fast without landmarks; smaller and fewer views in a quick run."""
    if quick:
        return profile("fast", landmark_views=0, views=3, view_size=400)
    return profile("fast", landmark_views=0)


@lru_cache(maxsize=1)
def subjects(path: str, trials: int, quick: bool, seed: int) -> Subjects:
    """Mark a scene as often as there are trials."""
    marked = tuple(mark_scene(path, config_of(quick), seed=seed + k) for k in range(trials))
    first = marked[0]
    baselines = []
    for name in BASELINES:
        model, kept = METHODS[name].embed(
            first.original, bench_key(seed), first.opened.message, first.report["psnr_worst_view"], first.opened.cameras
        )
        baselines.append(BaselineMark(name, model, kept))
    return Subjects(marked, tuple(baselines))
