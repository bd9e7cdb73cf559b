"""What several studies measure on: a scene marked by the profile fast, and 8-bit pictures of models."""

from functools import lru_cache

from engine.flows.embed.profiles import EmbedConfig, profile
from engine.lab.evaluate.bench.attacks import to_8_bit
from engine.lab.evaluate.marked_scene import MarkedScene, mark_scene
from engine.model import Camera, Float32, GaussianModel
from engine.raster import render

__all__ = ["fast_config", "fast_mark", "picture_of"]


def fast_config(quick: bool) -> EmbedConfig:
    """Profile fast without landmarks; smaller and fewer views in a quick run."""
    return profile("fast", landmark_views=0, **({"views": 3, "view_size": 400} if quick else {}))


@lru_cache(maxsize=3)
def fast_mark(path: str, quick: bool, seed: int) -> MarkedScene:
    """A scene marked with 32 bits, made once for each process."""
    return mark_scene(path, fast_config(quick), seed=seed)


def picture_of(model: GaussianModel, camera: Camera) -> Float32:
    """(H, W, 3) what a stored picture of a model holds."""
    return to_8_bit(render(model, camera))
