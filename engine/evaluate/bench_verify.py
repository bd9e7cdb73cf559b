"""How long a verification takes for each kind of suspect (`mark3dgs bench verify`).

Contract as in bench_embed.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from engine.evaluate.bench_embed import in_own_process, spread, stage_medians

if TYPE_CHECKING:
    from engine.pipeline.verification import Verification

__all__ = ["bench_verify"]


def bench_verify(
    scenes: Sequence[str | Path],
    profile: str = "fast",
    repeats: int = 3,
    seed: int = 0,
    advance: Callable[[float], None] | None = None,
) -> dict[str, Any]:
    """Time verifications of one marked scene after another.

    Suspects: the marked model moved, scaled and shuffled ("model"); one 800x800 picture from a known camera
    after JPEG 80 ("picture"); an 800x600 screenshot after JPEG 80 whose camera nobody knows ("screenshot").

    Parameters
    ----------
    scenes : sequence of path
        Model files; each is marked with 32 bits first.
    profile : str
        Of that embedding.
    repeats : int
        Timed runs, after one that is not.
    seed : int
        Of key, attacks and camera.
    advance : callable, optional
        Called with the fraction done.

    Returns
    -------
    dict
        `profile`, `repeats` and `rows`, one a scene and suspect: seconds (median, least, most),
        seconds_by_stage, verdict, z, bit_accuracy, peak_memory_mb (of the scene so far, embedding included).
    """
    rows: list[dict[str, Any]] = []
    for number, scene in enumerate(scenes):
        rows += in_own_process(_measure, str(scene), profile, repeats, seed)
        if advance:
            advance((number + 1) / len(scenes))
    return {"profile": profile, "repeats": repeats, "rows": rows}


def _measure(path: str, profile: str, repeats: int, seed: int) -> list[dict[str, Any]]:
    import numpy as np

    from engine.evaluate.bars_images import random_view, to_8_bit
    from engine.evaluate.marked_scene import mark_scene
    from engine.numerics.machine import peak_memory_mb
    from engine.pipeline.profiles import profile as named_profile
    from engine.pipeline.verification import verify_images, verify_model
    from engine.raster import render
    from engine.sim.attacks import image_attack
    from engine.sim.suite import Trial, apply_chain

    scene = mark_scene(path, named_profile(profile), seed=seed)
    opened, jpeg = scene.opened, image_attack("jpeg")
    stolen = apply_chain(scene.marked, Trial("moved", (("similarity", 4.0), ("shuffle", 1.0)), "bench"), seed)
    camera = opened.cameras[0]
    picture = jpeg.apply(to_8_bit(render(scene.marked, camera)), 80)
    anywhere = random_view(scene.original, np.random.default_rng(seed), 800, 600)
    screenshot = jpeg.apply(to_8_bit(render(scene.marked, anywhere)), 80)
    suspects: dict[str, Callable[[], Verification]] = {
        "model": lambda: verify_model(stolen, opened),
        "picture": lambda: verify_images([picture], opened, cameras=[camera]),
        "screenshot": lambda: verify_images([screenshot], opened),
    }
    rows = []
    for name, check in suspects.items():
        timed = [check() for _ in range(repeats + 1)][1:]
        claim = timed[-1].claim
        rows.append(
            {
                "scene": scene.name,
                "gaussians": len(scene.original),
                "suspect": name,
                **spread([run.seconds for run in timed]),
                "seconds_by_stage": stage_medians([run.seconds_by_stage for run in timed]),
                "verdict": claim.verdict.value,
                "z": claim.z,
                "bit_accuracy": claim.bit_accuracy,
                "peak_memory_mb": peak_memory_mb(),
            }
        )
    return rows
