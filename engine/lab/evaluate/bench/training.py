"""What trainings leave of a mark: fine-tuning by the paper's Table 5, and fresh models trained on renders.

The latter has no published results. Our reading is informed: it uses the owner's record, blind decoders do not.
"""

from collections.abc import Iterator, Sequence

import numpy as np

from engine.flows.embed.profiles import profile as named_profile
from engine.flows.verify.search import VerifyConfig, verify_images, verify_model
from engine.flows.views.camera_rig import make_rig
from engine.lab.evaluate.bench.attacks import claim_row, to_8_bit
from engine.lab.evaluate.marked_scene import Changes, MarkedScene, configure, mark_scene
from engine.lab.evaluate.study import Row
from engine.lab.sim.adversaries.retraining import (
    SETTINGS,
    RetrainConfig,
    fine_tune_stages,
    pictures_of,
    quality_lost,
    retraining_steps,
)
from engine.numerics.image_metrics import psnr
from engine.raster import render

TABLE_5 = (0, 100, 300, 500)
"""Epochs of the paper's table."""
HELD_OUT = 6
"""Views of the thief's kind that he does not train on; also the pictures of the image route."""
READ = ("z", "log10_false_claim", "bit_accuracy", "verdict")


def stops_until(epochs: int) -> tuple[int, ...]:
    """The table's numbers of epochs up to `epochs`, and that one."""
    return (*(stop for stop in TABLE_5 if stop < epochs), epochs)


def measure_fine_tuning(
    scene: str, setting: str, seed: int, profile: str, epochs: int, *, size: int = 400, changes: Changes | None = None
) -> list[Row]:
    """Bits and claim of the model route along one training by a setting of SETTINGS; a row for each number of epochs.

    The pictures have `size` pixels a side; `changes` are of the profile (see `configure`). `psnr_to_clean` is the worst
    view's PSNR against the unmarked model: what the training has done to the product.
    """
    marked, chosen = mark_scene(scene, configure(profile, changes or {}), seed=seed), SETTINGS[setting]
    cameras, images = pictures_of(chosen, marked.original, marked.marked, marked.opened.cameras, size=size, seed=seed)
    clean = [render(marked.original, camera) for camera in cameras]
    rows = []
    stages = fine_tune_stages(marked.marked, cameras, images, stops_until(epochs), trained="all", seed=seed)
    for epoch, tuned in stages:
        result = verify_model(tuned, marked.opened, VerifyConfig(route="model"))
        worst = min(psnr(image, render(tuned, camera)) for image, camera in zip(clean, cameras, strict=True))
        about = {"scene": marked.name, "setting": setting, "trained": "all", "epochs": epoch, "psnr_to_clean": worst}
        rows.append({**about, **claim_row("fine-tuning", result)})
    return rows


def measure_retraining(scene: str, seed: int, profile: str) -> list[Row]:
    """A scene marked, and what `read_retrained` says of it."""
    return list(read_retrained(mark_scene(scene, named_profile(profile), seed=seed), seed=seed))


def read_retrained(
    scene: MarkedScene,
    *,
    views: Sequence[int] = (10, 30, 100, 300),
    stops: Sequence[int] = (300, 1_000, 3_000),
    size: int = 400,
    config: RetrainConfig | None = None,
    seed: int = 0,
) -> Iterator[Row]:
    """Claims by the render route and from pictures along re-trainings from more and more views.

    The thief trains once on each number of renders of the stolen model, `size` pixels a side; a row for each training,
    rising number of steps after which its model is verified, and route, with `quality_lost`. Of a scene without
    landmarks the pictures' cameras are given.
    """
    rng = np.random.default_rng(seed)
    held_out = make_rig(scene.marked, HELD_OUT, size, size, jitter=rng.random((HELD_OUT, 4)))
    for count in views:
        cameras = make_rig(scene.marked, count, size, size, jitter=rng.random((count, 4)))
        for steps, model in retraining_steps(scene.marked, cameras, stops, config):
            cost = quality_lost(model, scene.marked, held_out)
            about = {"views": count, "steps": steps, "gaussians": len(model), **cost}
            pictures = [to_8_bit(render(model, camera)) for camera in held_out]
            known = held_out if scene.opened.landmarks is None else None
            readings = {
                "render": verify_model(model, scene.opened, VerifyConfig(route="render")),
                "image": verify_images(pictures, scene.opened, cameras=known),
            }
            for route, reading in readings.items():
                claim = claim_row("", reading)
                yield {**about, "route": route, **{name: claim[name] for name in READ}}
