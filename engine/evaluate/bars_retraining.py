"""What is left of a mark in a fresh model trained on renders of the marked one; nobody has published this.

Our reading is informed: it uses the owner's record, which blind decoders do without.
"""

from collections.abc import Callable, Iterator, Sequence
from typing import Any

import numpy as np

from engine.evaluate.bars_images import to_8_bit
from engine.evaluate.marked_scene import MarkedScene
from engine.model import Camera, GaussianModel
from engine.pipeline.rigs import make_rig
from engine.pipeline.verification import VerifyConfig, verify_images, verify_model
from engine.raster import render
from engine.sim.adversaries.retraining import RetrainConfig, quality_lost, retraining_steps

__all__ = ["bench_retraining"]

HELD_OUT = 6
"""Views of the thief's kind that he does not train on; also the pictures of the image route."""


def bench_retraining(
    scene: MarkedScene,
    *,
    views: Sequence[int] = (10, 30, 100, 300),
    stops: Sequence[int] = (300, 1_000, 3_000),
    size: int = 400,
    config: RetrainConfig | None = None,
    seed: int = 0,
    advance: Callable[[float], None] | None = None,
) -> Iterator[dict[str, Any]]:
    """Claims by the render route and from pictures along re-trainings from more and more views.

    Parameters
    ----------
    scene : MarkedScene
        With landmarks, or the pictures' cameras are given.
    views : sequence of int
        Renders of the stolen model that the thief trains on; one training each.
    stops : sequence of int
        Steps of a training after which its model is verified, rising.
    size : int
        Pixels a side of the thief's renders.
    seed : int
        Of the thief's views.
    advance : callable, optional
        Told the fraction of the steps of one training done.

    Yields
    ------
    dict
        One row for each training, stop and route: `views`, `steps`, `gaussians`, `psnr_to_stolen`, `lost_db` (see
        `quality_lost`), `route`, `z`, `log10_false_claim`, `bit_accuracy`, `verdict`.
    """
    rng = np.random.default_rng(seed)
    held_out = make_rig(scene.marked, HELD_OUT, size, size, jitter=rng.random((HELD_OUT, 4)))
    for count in views:
        cameras = make_rig(scene.marked, count, size, size, jitter=rng.random((count, 4)))
        for steps, model in retraining_steps(scene.marked, cameras, stops, config, advance):
            cost = quality_lost(model, scene.marked, held_out)
            for route, claim in _claims(scene, model, held_out):
                yield {
                    "views": count,
                    "steps": steps,
                    "gaussians": len(model),
                    **cost,
                    "route": route,
                    "z": claim.z,
                    "log10_false_claim": claim.log10_false_claim,
                    "bit_accuracy": claim.bit_accuracy,
                    "verdict": claim.verdict.value,
                }


def _claims(scene: MarkedScene, model: GaussianModel, cameras: Sequence[Camera]) -> Iterator[tuple[str, Any]]:
    yield "render", verify_model(model, scene.opened, VerifyConfig(route="render")).claim
    pictures = [to_8_bit(np.clip(render(model, camera), 0.0, 1.0)) for camera in cameras]
    known = cameras if scene.opened.landmarks is None else None
    yield "image", verify_images(pictures, scene.opened, cameras=known).claim
