"""Fine-tuning by the four settings of the paper's Table 5 (`mark3dgs bench finetune`)."""

from collections.abc import Callable
from typing import Any, Literal

from engine.evaluate.bars_models import row
from engine.evaluate.marked_scene import MarkedScene
from engine.numerics.image_metrics import psnr
from engine.pipeline.verification import VerifyConfig, verify_model
from engine.raster import render
from engine.sim.fine_tuning import FineTuneSetting, fine_tune_stages, pictures_of

TABLE_5 = (0, 100, 300, 500)
"""Epochs of the paper's table."""


def stops_until(epochs: int) -> tuple[int, ...]:
    """The table's numbers of epochs up to the one asked for, and that one."""
    return (*(stop for stop in TABLE_5 if stop < epochs), epochs)


def bench_fine_tuning(
    scene: MarkedScene,
    setting: FineTuneSetting,
    *,
    epochs: int = 500,
    trained: Literal["all", "colors"] = "all",
    size: int = 400,
    seed: int = 0,
    advance: Callable[[float], None] | None = None,
) -> list[dict[str, Any]]:
    """Bits and claim of the model route along one training; a row for each number of epochs.

    `psnr_to_clean` is the worst view's PSNR against the unmarked model: what the training has done to the product.
    """
    cameras, images = pictures_of(setting, scene.original, scene.marked, scene.opened.cameras, size=size, seed=seed)
    clean = [render(scene.original, camera) for camera in cameras]
    rows = []
    for epoch, tuned in fine_tune_stages(
        scene.marked, cameras, images, stops_until(epochs), trained=trained, seed=seed, advance=advance
    ):
        result = verify_model(tuned, scene.opened, VerifyConfig(route="model"))
        worst = min(psnr(image, render(tuned, camera)) for image, camera in zip(clean, cameras, strict=True))
        rows.append(
            {
                "scene": scene.name,
                "setting": setting.name,
                "trained": trained,
                "epochs": epoch,
                "psnr_to_clean": worst,
                **row("fine-tuning", result, result.seconds),
            }
        )
    return rows
