"""Table 3: time to mark and to verify, frames a second, bytes."""

import statistics
from pathlib import Path
from typing import Any

from engine.evaluate.bench.raster import bench_camera
from engine.evaluate.marked_scene import MarkedScene, mark_scene
from engine.evaluate.study import Row
from engine.formats import encode_model
from engine.model import GaussianModel
from engine.pipeline.profiles import profile
from engine.pipeline.verification import verify_model
from engine.raster import render

__all__ = ["measure_costs"]

FORMATS = ("ply", "compressed.ply", "splat", "spz", "sog")


def measure_costs(
    scene: str, named_profile: str, seed: int, repeats: int, width: int, height: int, changes: dict[str, Any]
) -> list[Row]:
    """Median of `repeats` markings and verifications, one before them not timed where there are several.

    Parameters
    ----------
    width, height : int
        Of the frames that are timed.
    changes : dict
        Fields of the profile.

    Returns
    -------
    list of dict
        One row: seconds to embed and to verify (median, least, most), frames a second without and with the mark,
        bytes in every format, and of "compact" as .sog.
    """
    warm = 1 if repeats > 1 else 0
    config = profile(named_profile, **changes)
    scenes = [mark_scene(scene, config, seed=seed) for _ in range(repeats + warm)]
    embeds = [made.report["seconds"] for made in scenes[warm:]]
    made = scenes[-1]
    verifies = [verify_model(made.marked, made.opened).seconds for _ in range(repeats + warm)][warm:]
    compact = mark_scene(
        scene, profile(named_profile, **{**changes, "output": "compact", "landmark_views": 0}), seed=seed
    )
    return [
        {
            "scene": Path(scene).name,
            "profile": named_profile,
            "gaussians": len(made.original),
            **_spread("embed", embeds),
            **_spread("verify", verifies),
            "fps_before": _frames(made.original, width, height, repeats),
            "fps_after": _frames(made.marked, width, height, repeats),
            "width": width,
            "height": height,
            "bytes": {kind: len(encode_model(made.marked, kind)) for kind in FORMATS},
            "compact_sog_bytes": len(encode_model(compact.marked, "sog")),
            **_fidelity(compact),
        }
    ]


def _spread(name: str, seconds: list[float]) -> dict[str, float]:
    return {name: statistics.median(seconds), f"{name}_least": min(seconds), f"{name}_most": max(seconds)}


def _frames(model: GaussianModel, width: int, height: int, repeats: int) -> float:
    """Frames a second: the median of `repeats` frames after one that is not timed."""
    import time

    camera = bench_camera(model, width, height)
    render(model, camera)
    times = []
    for _ in range(max(repeats, 3)):
        began = time.perf_counter()
        render(model, camera)
        times.append(time.perf_counter() - began)
    return 1.0 / statistics.median(times)


def _fidelity(compact: MarkedScene) -> dict[str, float]:
    return {"compact_psnr": compact.report["psnr_total_worst_view"]}
