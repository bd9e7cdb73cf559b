"""What fine-tuning by the paper's Table 5 leaves of a mark. Our reading is informed, by the owner's record."""

from engine.flows.verify.search import VerifyConfig, verify_model
from engine.lab.evaluate.bench.attacks import claim_row
from engine.lab.evaluate.marked_scene import Changes, configure, mark_scene
from engine.lab.evaluate.study import Row
from engine.lab.sim.adversaries.retraining import SETTINGS, fine_tune_stages, pictures_of
from engine.numerics.image_metrics import psnr
from engine.raster import render

TABLE_5 = (0, 100, 300, 500)
"""Epochs of the paper's table."""


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
