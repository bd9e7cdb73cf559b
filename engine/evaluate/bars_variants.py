"""The paper's Table 4 on variants made from a 3DGS scene (`mark3dgs bench variants`).

No file of these variants is at hand, so each is made: discs by flattening and refitting, a moving scene by swaying and
fitting Spacetime Gaussians, a codebook model by clustering, a generated one by training on few pictures.
"""

import tempfile
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from engine.compress.pruning import PruneConfig
from engine.evaluate.marked_scene import bench_key
from engine.formats import read_model
from engine.model import GaussianModel
from engine.pipeline.profiles import EmbedConfig, profile
from engine.pipeline.rigs import make_rig
from engine.raster import render
from engine.sim.variants.table4 import VariantRow
from engine.watermark.keys import OwnerKey

GENERATED_VIEWS, GENERATED_SIZE, GENERATED_STEPS = 24, 256, 500
"""Pictures that a stand-in of a generator sees, their side in pixels, and its steps: it stays coarse."""
CODEBOOK_BUDGET_DB = 35.0
"""Compact3D prunes before it clusters; what is left renders this near to the original."""


def bench_variant(kind: str, path: Path, seed: int = 0) -> dict[str, Any]:
    """Make one variant of a scene, mark it, attack it.

    Parameters
    ----------
    kind : {"2dgs", "4dgs", "compact3d", "dreamgaussian"}
    path : Path
        A 3DGS model.
    seed : int
        Of views and attacks.

    Returns
    -------
    dict
        A row of Table 4, with the weakest of its readings.
    """
    original = read_model(path).model
    config = profile("balanced", landmark_views=0)
    with tempfile.TemporaryDirectory() as folder:
        row = VARIANTS[kind](original, bench_key(seed), config, Path(folder), seed)
    weakest = min(row.readings, key=lambda reading: (reading.bit_accuracy, reading.z))
    return {
        "scene": path.name,
        "variant": row.name,
        "gaussians": len(original),
        "psnr_before": row.psnr_before,
        "psnr_after": row.psnr_after,
        "psnr_drop": row.psnr_drop,
        "ms_ssim_distance_before": row.distance_before,
        "ms_ssim_distance_after": row.distance_after,
        "psnr_of_mark": row.psnr_of_mark,
        "cases": len(row.readings),
        "claimed": sum(reading.verdict == "marked" for reading in row.readings),
        "all_bits": sum(reading.bit_accuracy == 1.0 for reading in row.readings),
        "weakest": weakest.case,
        "weakest_bits": weakest.bit_accuracy,
        "weakest_z": weakest.z,
        "row": row.to_json(),
    }


def _discs(original: GaussianModel, key: OwnerKey, config: EmbedConfig, folder: Path, seed: int) -> VariantRow:
    from engine.sim.variants.discs import make_discs
    from engine.sim.variants.measuring import measure_discs

    return measure_discs(original, make_discs(original), key, config, seed=seed)


def _moving(original: GaussianModel, key: OwnerKey, config: EmbedConfig, folder: Path, seed: int) -> VariantRow:
    from engine.sim.variants.measuring import measure_spacetime
    from engine.sim.variants.swaying import fit_spacetime, set_in_motion

    truth = set_in_motion(original, seed=seed)
    return measure_spacetime(truth, fit_spacetime(truth), key, config, seed=seed)


def _codebook(original: GaussianModel, key: OwnerKey, config: EmbedConfig, folder: Path, seed: int) -> VariantRow:
    from engine.compress.impact import measure_impact
    from engine.pipeline.delivery import slim_down
    from engine.pipeline.rigs import measure_extent
    from engine.pipeline.scenes import look
    from engine.sim.variants.codebook import make_codebook
    from engine.sim.variants.measuring import measure_codebook

    views = look(original, make_rig(original, 8, 512, 512), lambda fraction: None)
    impact = measure_impact(original, views.views, views.images)
    pruned = profile("balanced", prune=PruneConfig(budget_db=CODEBOOK_BUDGET_DB))
    slim, _ = slim_down(original, views, impact, measure_extent(original), pruned)
    return measure_codebook(original, make_codebook(slim), key, config, folder, seed=seed)


def _generated(original: GaussianModel, key: OwnerKey, config: EmbedConfig, folder: Path, seed: int) -> VariantRow:
    from engine.sim.variants.generative import FEW_GAUSSIANS, generate_from_views
    from engine.sim.variants.measuring import measure_generated

    rig = make_rig(original, GENERATED_VIEWS, GENERATED_SIZE, GENERATED_SIZE)
    pictures = [np.clip(render(original, camera), 0.0, 1.0) for camera in rig]
    generated = generate_from_views(rig, pictures, steps=GENERATED_STEPS)
    return measure_generated(original, generated, key, replace(FEW_GAUSSIANS, landmark_views=0), folder, seed=seed)


VARIANTS: dict[str, Callable[[GaussianModel, OwnerKey, EmbedConfig, Path, int], VariantRow]] = {
    "2dgs": _discs,
    "4dgs": _moving,
    "compact3d": _codebook,
    "dreamgaussian": _generated,
}
