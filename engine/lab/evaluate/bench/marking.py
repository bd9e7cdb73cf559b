"""What marks cost: budgets, the profile `auto`; and the paper's Table 4 on variants made from a 3DGS scene.

No file of these variants is at hand, so each is made: discs by flattening and refitting, a moving scene by swaying and
fitting Spacetime Gaussians, a codebook model by clustering, a generated one by training on few pictures.
"""

import itertools
import math
import tempfile
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from statistics import fmean

import numpy as np

from engine.compress.pruning import PruneConfig
from engine.flows.embed.embedding import Embedding, embed
from engine.flows.embed.profiles import AUTO, Auto, EmbedConfig, Settings, compose
from engine.flows.embed.profiles import profile as named_profile
from engine.flows.records.opened_record import open_record
from engine.flows.views.camera_rig import make_rig
from engine.flows.views.view_set import worst_psnr_against
from engine.formats import encode_model, read_model
from engine.lab.evaluate.bench.attacks import other_views, read_attacked, to_8_bit
from engine.lab.evaluate.marked_scene import MarkedScene, bench_key, mark_scene
from engine.lab.evaluate.study import Row
from engine.lab.sim.suite import Trial
from engine.lab.sim.variants.variant_table import VariantRow
from engine.model import GaussianModel
from engine.raster import render
from engine.watermark.keys import OwnerKey
from engine.watermark.rates import MADE_FIRST

GENERATED_VIEWS, GENERATED_SIZE, GENERATED_STEPS = 24, 256, 500
"""Pictures that a stand-in of a generator sees, their side in pixels, and its steps: it stays coarse."""
CODEBOOK_BUDGET_DB = 35.0
"""Compact3D prunes before it clusters; what is left renders this near to the original."""


UNSEEN, UNSEEN_SIDE = 12, 800
"""Views without the key, and their pixels a side."""
BUDGETS_DB, AUTO_DB = (45.0, 40.0, 37.5, 35.0), 40.0
PICTURES = 3
"""Of the unseen views, kept as JPEG 10 and read."""
JPEG_10 = Trial("picture, JPEG 10", (("jpeg", 10),), "", "image")
FIELDS = (
    "device",
    "gaussians_out",
    "psnr_worst_view",
    "ssim_worst_view",
    "psnr_total_worst_view",
    "psnr_pruned_worst_view",
    "predicted_z_render",
)


def measure_budgets(scene: str, seed: int, profile: str, device: str) -> list[Row]:
    """The whole model, pruned and compact ones without and with recovery, and what `auto` makes of one budget: what is
    left, what it costs, and what views show that neither the key nor the fit knows, of files read back, too."""
    plain, rows = named_profile(profile, landmark_views=0, device=device), list[Row]()
    cases: list[tuple[str, float | None, bool]] = [("whole", None, False), (AUTO, AUTO_DB, True)]
    cases += itertools.product(("pruned", "compact"), BUDGETS_DB, (False, True))
    for output, wanted_db, recover in cases:
        prune = PruneConfig(budget_db=None if output == "compact" else wanted_db, recover=recover)
        config: Settings = replace(plain, prune=prune)
        if output == "compact":
            config = replace(plain, prune=prune, output=output, compact_db=wanted_db or 0.0)
        elif output == AUTO:
            config = Auto(replace(Auto().start, prune=prune, device=device), format="sog")
        began, at = time.process_time(), time.perf_counter()
        made = mark_scene(scene, config, seed=seed)
        seconds = {"cpu_seconds": time.process_time() - began, "seconds": time.perf_counter() - at}
        views = other_views(made.original, UNSEEN, UNSEEN_SIDE, (seed, 0x5EE))
        unseen = worst_psnr_against([render(made.original, camera) for camera in views], views)
        pictures = [(to_8_bit(render(made.marked, camera)), camera) for camera in views[:PICTURES]]
        readings = [read_attacked(made, JPEG_10, seed, picture, camera) for picture, camera in pictures]
        row: Row = {"scene": Path(scene).name, "output": output, "wanted_db": wanted_db, "recover": recover, **seconds}
        row |= {field: made.report[field] for field in FIELDS if field in made.report}
        row |= {"psnr_pruned_unseen": unseen(made.opened.reference)}
        row |= {"z_jpeg_10": min(reading.claim.z for reading in readings)}
        for kind in ("ply", "sog"):
            written = encode_model(made.marked, kind)
            row |= {f"{kind}_bytes": len(written), f"{kind}_unseen": unseen(read_model(written).model)}
        rows.append(row)
    return rows


def measure_promises(scene: str, seed: int) -> list[Row]:
    """Profile `auto` beside `fast` and `balanced`: processor seconds to embed, the least of two; what it promises of
    one picture at JPEG quality 10, and what such pictures of other views show."""
    loaded, key, rows = read_model(scene), bench_key(seed), list[Row]()
    digest = loaded.sha256
    tiny = named_profile("fast", views=2, view_size=128, landmark_views=2, psnr_db=40.0)
    embed(loaded.model, key, original_sha256=digest, bits=16, config=tiny)  # the first pays for what later ones find
    names, results, seconds = (AUTO, "fast", "balanced"), dict[str, Embedding](), dict[str, float]()
    for name in (*names, *reversed(names)):  # the first to need the memory pays for it: each comes early and late
        began = time.process_time()
        results[name] = embed(loaded.model, key, original_sha256=digest, config=compose(name))
        seconds[name] = min(time.process_time() - began, seconds.get(name, math.inf))
    for name, made in results.items():
        row: Row = {"scene": Path(scene).name, "profile": name, "cpu_seconds": seconds[name]}
        row |= {field: made.report[field] for field in ("psnr_worst_view", "ssim_worst_view", "predicted_z_render")}
        if (choice := made.report.choice) is not None:
            opened = open_record(made.record.to_bytes(key), key, MADE_FIRST)
            marked = MarkedScene(Path(scene).name, loaded.model, made.model, opened, made.report)
            views = other_views(loaded.model, PICTURES, UNSEEN_SIDE, (seed, 0x5EE))
            pictures = [(to_8_bit(render(made.model, camera)), camera) for camera in views]
            z = [read_attacked(marked, JPEG_10, seed, *each).claim.z for each in pictures]
            row |= {"views": choice.views, "wanted_z": choice.wanted_z, "z_jpeg_10": fmean(z), "z_least": min(z)}
            row["of_promise"] = fmean(z) / choice.predicted_z
        rows.append(row)
    return rows


def measure_variants(scene: str, setting: str, seed: int) -> list[Row]:
    """One row of Table 4 with the weakest of its readings: a 3DGS scene made one of VARIANTS, marked and attacked.

    Takes one to two minutes on 100k Gaussians.
    """
    original = read_model(scene).model
    config = named_profile("balanced", landmark_views=0)
    with tempfile.TemporaryDirectory() as folder:
        row = VARIANTS[setting](original, bench_key(seed), config, Path(folder), seed)
    weakest = min(row.readings, key=lambda reading: (reading.bit_accuracy, reading.z))
    found = {
        "scene": Path(scene).name,
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
    return [found]


def _discs(original: GaussianModel, key: OwnerKey, config: EmbedConfig, folder: Path, seed: int) -> VariantRow:
    from engine.lab.sim.variants.synthetic import make_discs
    from engine.lab.sim.variants.variant_table import measure_discs

    return measure_discs(original, make_discs(original), key, config, seed=seed)


def _moving(original: GaussianModel, key: OwnerKey, config: EmbedConfig, folder: Path, seed: int) -> VariantRow:
    from engine.lab.sim.variants.synthetic import fit_spacetime, set_in_motion
    from engine.lab.sim.variants.variant_table import measure_spacetime

    truth = set_in_motion(original, seed=seed)
    return measure_spacetime(truth, fit_spacetime(truth), key, config, seed=seed)


def _codebook(original: GaussianModel, key: OwnerKey, config: EmbedConfig, folder: Path, seed: int) -> VariantRow:
    from engine.flows.embed.delivery import slim_down
    from engine.flows.embed.planning_basis import lay_groundwork
    from engine.flows.progress import Clock
    from engine.lab.sim.variants.codebooks import make_codebook
    from engine.lab.sim.variants.variant_table import measure_codebook

    pruned = named_profile("balanced", views=8, view_size=512, prune=PruneConfig(budget_db=CODEBOOK_BUDGET_DB))
    slim, _ = slim_down(lay_groundwork(original, key, "00" * 32, pruned), pruned, Clock())
    return measure_codebook(original, make_codebook(slim), key, config, folder, seed=seed)


def _generated(original: GaussianModel, key: OwnerKey, config: EmbedConfig, folder: Path, seed: int) -> VariantRow:
    from engine.lab.sim.variants.generative import FEW_GAUSSIANS, generate_from_views
    from engine.lab.sim.variants.variant_table import measure_generated

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
