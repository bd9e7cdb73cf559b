"""The paper's early stop (Eq 8) over its threshold: which pixels end, what it costs a picture, what is still read."""

import time

import numpy as np

from engine.flows.verify.decision import Reading, VerifyConfig, judge
from engine.flows.views.view_set import early_stop
from engine.lab.evaluate.bench.attacks import other_views, read_attacked, to_8_bit
from engine.lab.evaluate.marked_scene import Changes
from engine.lab.evaluate.study import Cell, Options, Row
from engine.lab.evaluate.tables.part import DEFAULT, changes_of, efforts, scenes_of
from engine.lab.evaluate.tables.tables_cells import OF_VIEWS, UNTOUCHED, mark_setting
from engine.numerics.image_metrics import psnr
from engine.raster import EarlyStop, prepare_view, sh_colors

TAUS = (0.8, 0.95, 1.0, 1.1, 1.2, 1.4, 1.6)
"""tau_occ of the paper's figure, and the tau of its text."""
ENDED = 1.0 / 255.0
"""A pixel whose opacity falls by more than this was ended by the stop."""


def measure_stops(scene: str, seed: int, views: int, size: int, changes: Changes, taus: list[float]) -> list[Row]:
    """A row for each view and tau, and for none (the whole picture)."""
    marked = mark_setting(scene, DEFAULT, seed, changes)
    weights = early_stop(marked.marked, 1.0).weights
    rows = []
    for number, camera in enumerate(other_views(marked.original, views, size, (seed, OF_VIEWS))):
        view = prepare_view(marked.marked, camera)
        colors = sh_colors(marked.marked.sh, marked.marked.means, camera.position.astype(np.float32))
        whole, alpha = view.render(colors)
        view.render(colors, None, EarlyStop(weights, taus[0]))  # compiled before anything is timed
        for tau in (None, *taus):
            early = None if tau is None else EarlyStop(weights, tau)
            began = time.perf_counter()
            picture, seen = view.render(colors, None, early)
            seconds = time.perf_counter() - began
            read = read_attacked(marked, UNTOUCHED, (seed, number), to_8_bit(picture), camera)
            by_paper = judge(Reading("image", read.evidence), marked.opened, VerifyConfig(decoder="paper"))
            rows.append(
                {
                    "kind": "stop",
                    "scene": marked.name,
                    "seed": seed,
                    "view": number,
                    "tau": tau,
                    "ended": float((alpha - seen > ENDED).mean()),
                    "psnr": None if tau is None else psnr(np.clip(whole, 0, 1), np.clip(picture, 0, 1)),
                    "z": read.claim.z,
                    "right": read.claim.matching_bits,
                    "right_by_eq10": by_paper.matching_bits,
                    "bits": read.claim.bits,
                    "blend_seconds": seconds,
                }
            )
    return rows


def cells(options: Options) -> list[Cell]:
    """One for each scene and key."""
    effort = efforts(options)[1]
    taus = [1.2] if options.quick else list(TAUS)
    shared = {"views": effort.views, "size": effort.size, "changes": changes_of(options), "taus": taus}
    return [
        Cell.of(f"stop-{short}-k{seed}", measure_stops, scene=path, seed=seed, **shared)
        for short, path in scenes_of(options)
        for seed in range(options.seed, options.seed + effort.keys)
    ]
