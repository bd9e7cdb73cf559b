"""One scene marked by one setting: fidelity, time, and what the model and pictures of it still say."""

from pathlib import Path
from typing import Any

import numpy as np

from engine.errors import CapacityError
from engine.evaluate.marked_scene import MarkedScene, bench_key
from engine.evaluate.study import Row
from engine.evaluate.tables.cells.shots import cameras_for, read_bits, readings_of_picture
from engine.evaluate.tables.setting import Setting, configure
from engine.evaluate.tables.without import without
from engine.formats import read_model
from engine.numerics.image_metrics import ms_ssim_distance, psnr, ssim
from engine.pipeline.embedding import embed
from engine.pipeline.sealing import open_record
from engine.pipeline.verification import VerifyConfig, verify_model
from engine.raster import render

__all__ = ["ATTACKS", "mark", "measure_setting"]

ATTACKS: dict[str, tuple[str, float, str]] = {
    "none": ("", 0.0, "literal"),
    "JPEG 10": ("jpeg", 10, "literal"),
    "noise 0.1": ("noise_image", 0.1, "literal"),
}
"""What single pictures go through where settings are compared: label, attack, strength, reading."""

_REPORTED = (
    "psnr_worst_view",
    "ssim_worst_view",
    "psnr_total_worst_view",
    "gaussians_in",
    "gaussians_out",
    "capacity_bits",
)


def measure_setting(
    scene: str, setting: dict[str, Any], seed: int, views: int, size: int, changes: dict[str, Any], attacked: bool
) -> list[Row]:
    """Mark a scene and look at it from views of its own.

    Parameters
    ----------
    scene : str
        Path of the model.
    setting : dict
        Of `Setting.to_json`.
    seed : int
        Of key, views and attacks.
    views, size : int
        Pictures, and their side in pixels (176 at least).
    changes : dict
        Of this run's effort, applied before the setting's own.
    attacked : bool
        Read each picture after every one of `ATTACKS`; as it is otherwise.

    Returns
    -------
    list of dict
        One ``"kind": "marked"`` (worst key view's fidelity, bits and z of the model itself, seconds), or ``"refused"``
        with the reason; one ``"view"`` for each view (PSNR, SSIM, 1 - MS-SSIM against the original), and one
        ``"picture"`` for each view and attack.
    """
    chosen = Setting(**setting)
    about = {"scene": Path(scene).name, "setting": chosen.name, "seed": seed}
    try:
        marked = mark(scene, chosen, seed, changes)
    except CapacityError as refusal:
        return [{**about, "kind": "refused", "reason": str(refusal), "capacity_bits": refusal.capacity}]
    shown = marked.original if chosen.unmarked else marked.marked
    whole = verify_model(shown, marked.opened, VerifyConfig(route="model"))
    rows: list[Row] = [
        {
            **about,
            "kind": "marked",
            **{name: marked.report[name] for name in _REPORTED},
            **read_bits(whole, marked, "model"),
            "embed_seconds": marked.report["seconds"],
            "refine_seconds": marked.report["seconds_by_stage"].get("refine", 0.0),
        }
    ]
    for k, camera in enumerate(cameras_for(marked.original, views, size, seed)):
        truth, picture = (np.clip(render(model, camera), 0.0, 1.0) for model in (marked.original, shown))
        rows.append(
            {
                **about,
                "kind": "view",
                "view": k,
                "psnr": psnr(truth, picture),
                "ssim": ssim(truth, picture),
                "distance": ms_ssim_distance(truth, picture),
            }
        )
        wanted = ATTACKS if attacked else {"none": ATTACKS["none"]}
        for reading in readings_of_picture(picture, camera, marked, wanted, (seed, k)):
            rows.append({**about, "kind": "picture", "view": k, **reading})
    return rows


def mark(scene: str, setting: Setting, seed: int, changes: dict[str, Any]) -> MarkedScene:
    """The scene marked by a setting; the record makes the round trip through its bytes."""
    config = configure(changes, setting.changes)
    loaded = read_model(scene)
    key = bench_key(seed)
    made = embed(
        loaded.model,
        key,
        original_sha256=loaded.sha256,
        bits=setting.bits,
        config=config,
        variant=without(setting.without, config.quantize),
    )
    opened = open_record(made.record.to_bytes(key), key)
    return MarkedScene(Path(scene).name, loaded.model, made.model, opened, made.report)
