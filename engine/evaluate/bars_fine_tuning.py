"""Fine-tuning on clean images at the key poses (Table 5's hardest setting; `mark3dgs bench finetune`)."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from engine.evaluate.bars_models import row
from engine.evaluate.marked_scene import MarkedScene
from engine.numerics.image_metrics import psnr
from engine.pipeline.verification import VerifyConfig, verify_model
from engine.raster import render


def bench_fine_tuning(
    scene: MarkedScene, epochs: int = 500, size: int = 400, advance: Callable[[float], None] | None = None
) -> dict[str, Any]:
    """Bits and claim after training all colours on renders of the unmarked model at the key poses."""
    from engine.sim.fine_tuning import fine_tune  # torch is only needed here

    cameras = [camera.resized(size, size) for camera in scene.opened.cameras]
    clean = [np.clip(render(scene.original, camera), 0.0, 1.0) for camera in cameras]
    tuned = fine_tune(scene.marked, cameras, clean, epochs, advance=advance)
    result = verify_model(tuned, scene.opened, VerifyConfig(route="model"))
    left = min(psnr(image, render(tuned, camera)) for image, camera in zip(clean, cameras, strict=True))
    return {
        "scene": scene.name,
        "epochs": epochs,
        "psnr_to_clean": left,
        **row("fine-tuning", result, result.seconds),
    }
