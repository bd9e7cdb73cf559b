"""The paper's early stop (Eq 8) over its threshold: which pixels end, what it costs a picture, what is still read."""

import time
from statistics import fmean

import numpy as np

from engine.flows.verify.decision import Reading, VerifyConfig, judge
from engine.flows.views.view_set import early_stop
from engine.lab.evaluate.bench.attacks import other_views, read_attacked, to_8_bit
from engine.lab.evaluate.figures import Axes, label_line, styles
from engine.lab.evaluate.marked_scene import Changes
from engine.lab.evaluate.study import Cell, Options, Row, Table
from engine.lab.evaluate.summary import accuracy, mean_text, picked, share_text, table
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


def stops_table(rows: list[Row]) -> Table:
    """A line a threshold."""
    return table(
        [{"tau": tau, "of": of} for tau in (None, *TAUS) if (of := _at(rows, tau))],
        ("tau_occ", lambda line: "none" if line["tau"] is None else line["tau"]),
        ("pixels ended, %", lambda line: mean_text([100 * row["ended"] for row in line["of"]])),
        ("PSNR to the whole picture, dB", lambda line: mean_text([r["psnr"] for r in line["of"] if r["psnr"]])),
        ("bits", lambda line: share_text(accuracy(line["of"]))),
        ("bits by Eq 10", lambda line: share_text(accuracy(line["of"], "right_by_eq10"))),
        ("z of a picture", lambda line: mean_text([row["z"] for row in line["of"]])),
        ("blending, ms", lambda line: f"{1000 * fmean(row['blend_seconds'] for row in line['of']):.1f}"),
        title="tau_occ: pixels end once sum_j alpha_j W_j reaches it (Eq 8; W is the rank of W^freq)",
    )


def draw_stops(axes: Axes, rows: list[Row]) -> None:
    """z of a picture over tau_occ, that of the whole picture as a line."""
    points = [(tau, fmean(row["z"] for row in of)) for tau in TAUS if (of := _at(rows, tau))]
    if points:
        axes.plot(*zip(*points, strict=True), label="no attack", **next(styles()))
        label_line(axes, 1.2, "the paper's best", along="y")
    if whole := _at(rows, None):
        axes.axhline(fmean(row["z"] for row in whole), color="#6a6a6a", linewidth=0.8, linestyle=":")
    axes.set_xlabel("tau_occ (dotted: no stop)")


def _at(rows: list[Row], tau: float | None) -> list[Row]:
    return picked(rows, kind="stop", tau=tau)
