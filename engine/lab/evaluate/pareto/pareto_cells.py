"""One setting on one scene: seconds, fidelity where the mark was not shaped, and what is read after attacks."""

import statistics
import time
from dataclasses import replace
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from engine.errors import CapacityError
from engine.flows.embed.auto_profile import Rehearsal, Rehearsing
from engine.flows.embed.config import CONFIG
from engine.flows.embed.copy_mark import whole_displacements
from engine.flows.embed.delivery import deliver
from engine.flows.embed.draft import Draft
from engine.flows.embed.embedding import Embedding, embed
from engine.flows.embed.layer_strengths import add_dc
from engine.flows.embed.planning_basis import lay_groundwork
from engine.flows.embed.profiles import AUTO, Auto, EmbedConfig
from engine.flows.embed.variant import PLAIN
from engine.flows.progress import Clock
from engine.flows.records.opened_record import OpenedRecord, open_record
from engine.formats import LoadedModel, encode_model, read_model
from engine.lab.evaluate.bench.attacks import other_views, read_attacked, read_screenshots, to_8_bit
from engine.lab.evaluate.bench.raster import bench_camera
from engine.lab.evaluate.bench.timing import median_ms, stage_medians
from engine.lab.evaluate.machine import load_per_core
from engine.lab.evaluate.marked_scene import MarkedScene, bench_key
from engine.lab.evaluate.pareto.points import BASE, Point, config_of
from engine.lab.evaluate.study import Row
from engine.lab.sim.suite import Trial
from engine.model import Camera, GaussianModel
from engine.numerics.image_metrics import psnr, ssim
from engine.raster import render
from engine.watermark.keys import OwnerKey
from engine.watermark.rates import MADE_FIRST

ATTACKS: tuple[Trial, ...] = (
    Trial("none", (), "", "model"),
    Trial("crop to 10 %", (("crop", 0.1),), "", "model"),
    Trial("noise 0.1 on all", (("noise_all", 0.1),), "", "model"),
    Trial(".splat and back", (("convert", "splat"),), "", "model"),
    Trial("picture", (), "", "image"),
    Trial("picture, JPEG 10", (("jpeg", 10),), "", "image"),
    Trial("picture, noise 0.1", (("noise_image", 0.1),), "", "image"),
)
"""What every setting is put through; literal readings, one picture a claim, its camera known."""

REPEATS = 3
HELD_OUT = 6
"""Views that no key view was; the first PICTURES of them are the pictures that are attacked."""
PICTURES = 2
SCREENSHOTS = 8
"""Of unknown camera, for the settings that differ in their landmarks."""
PREDICTED = ("profile", "cells", "fidelity", "auto", "corner")
"""Axes on which `choosing` is held against what is measured."""
FPS_SIZE = (1297, 840)
OF_VIEWS = 0x4E1D
"""Of the stream that draws those views."""
QUICK_SIZE = 256
QUICK_ATTACKS = ("none", "noise 0.1 on all", "picture", "picture, JPEG 10")


def measure_point(scene: str, point: dict[str, Any], seed: int, quick: bool) -> list[Row]:
    """Everything about one setting (fields of `Point`) on one scene; quick: small views, no landmarks, one run.

    One row, or none where the point does not apply (an SH degree that the scene does not have). A message that the
    scene cannot carry gives a row with `refused`.
    """
    setting = Point(**point)
    loaded = _read(scene)
    model = loaded.model
    if setting.degree is not None:
        if setting.degree >= model.sh_degree:
            return []
        model = model.with_(sh=np.ascontiguousarray(model.sh[:, : (setting.degree + 1) ** 2]))
    size = QUICK_SIZE if quick else 800
    about = {"scene": Path(scene).name, "point": point, "gaussians": len(loaded.model)}
    _warm(scene)
    try:
        made, timed = _timed(model, loaded.sha256, setting, seed, quick)
    except CapacityError as error:
        return [{**about, "refused": str(error), "capacity_bits": error.capacity}]
    config, key = made.config, bench_key(seed)
    record = made.record.to_bytes(key)
    views = other_views(loaded.model, HELD_OUT, size, (seed, OF_VIEWS))[: 2 if quick else None]
    subject = MarkedScene(Path(scene).name, loaded.model, made.model, open_record(record, key, MADE_FIRST), made.report)
    camera = bench_camera(loaded.model, *((320, 200) if quick else FPS_SIZE))
    predicted = None
    if setting.axis in PREDICTED and not quick:
        predicted = rehearse(model, key, config, loaded.sha256).predicted_z
    row = {
        **about,
        "views": config.views,
        "view_size": config.view_size,
        "cells": config.quantize.cells,
        "psnr_asked": config.psnr_db,
        "landmark_views": config_of(setting).landmark_views,
        "bits": setting.bits,
        "gaussians_out": len(made.model),
        **timed,
        "busy": load_per_core(),
        "shares_landmarks": setting.shares_landmarks and not quick,
        "predicted_z": predicted,
        **_fidelity(subject, loaded.model, views),
        "frame_ms": median_ms(lambda: render(made.model, camera), 3 if quick else 9),
        "frame_size": [camera.width, camera.height],
        "sog_bytes": len(encode_model(made.model, "sog")),
        "record_bytes": len(record),
        **{name: made.report[name] for name in ("psnr_worst_view", "ssim_worst_view", "capacity_bits")},
        **_attacked(subject, views[: 1 if quick else PICTURES], seed, quick),
    }
    if not quick and config.landmark_views and (setting == BASE or setting.axis == "landmarks"):
        shots = read_screenshots(subject, SCREENSHOTS, seed)
        row["screenshots"] = [sum(shot["verdict"] == "marked" for shot in shots), len(shots)]
    return [row]


def _timed(model: GaussianModel, digest: str, point: Point, seed: int, quick: bool) -> tuple[Embedding, Row]:
    """Embed once in full, then without the landmark bank: long and steady, it is timed once.

    Returns the first embedding and a row: median of each stage, processor time of each run (the first has the landmark
    bank if any has), and what was chosen.
    """
    more = {"landmark_views": 0, "view_size": QUICK_SIZE} if quick else {}
    if point.shares_landmarks:
        more["landmark_views"] = 0
    made: list[Embedding] = []
    cpu: list[float] = []
    for _ in range(1 if quick else REPEATS):
        config = config_of(point, **more)
        chosen = Auto(config, format="sog") if point.profile == AUTO else config
        began = time.process_time()
        made.append(embed(model, bench_key(seed), original_sha256=digest, bits=point.bits, config=chosen))
        cpu.append(time.process_time() - began)
        more["landmark_views"] = 0
    first = made[0].report
    bank = {"landmarks": first["seconds_by_stage"]["landmarks"]}
    stages = stage_medians([{**again.report["seconds_by_stage"], **bank} for again in made])
    return made[0], {"stages": stages, "cpu_seconds": cpu, "choice": first["choice"]}


@lru_cache(maxsize=1)
def _read(scene: str) -> LoadedModel:
    return read_model(scene)


@lru_cache(maxsize=1)
def _warm(scene: str) -> None:
    """The first embedding of a process pays for things that later ones find ready."""
    loaded = _read(scene)
    embed(
        loaded.model,
        bench_key(0),
        original_sha256=loaded.sha256,
        bits=16,
        config=EmbedConfig(views=2, view_size=128, landmark_views=2, psnr_db=40.0),
    )


def _fidelity(subject: MarkedScene, original: GaussianModel, views: list[Camera]) -> Row:
    """Of the mark alone and of everything together, in views where the mark was not shaped."""
    delivered = _unmarked(subject.marked, subject.opened)
    seen = [[render(model, camera) for model in (subject.marked, delivered, original)] for camera in views]
    return {
        "psnr_held_out": [psnr(clean, marked) for marked, clean, _ in seen],
        "ssim_held_out": min(ssim(clean, marked) for marked, clean, _ in seen),
        "psnr_total_held_out": min(psnr(truth, marked) for marked, _, truth in seen),
    }


def _unmarked(marked: GaussianModel, opened: OpenedRecord) -> GaussianModel:
    """The delivered model without its mark: what the record says was added is taken away."""
    return marked.with_(sh=add_dc(marked.sh, -whole_displacements(opened)[0]))


def _attacked(subject: MarkedScene, cameras: list[Camera], seed: int, quick: bool) -> Row:
    pictures = [(to_8_bit(render(subject.marked, camera)), camera) for camera in cameras]
    attacks: dict[str, Row] = {}
    seconds: dict[str, float] = {}
    for trial in ATTACKS:
        if quick and trial.label not in QUICK_ATTACKS:
            continue
        if trial.kind == "model":
            times = 1 if trial.chain or quick else REPEATS
            runs = [read_attacked(subject, trial, seed, subject.marked) for _ in range(times)]
        else:
            runs = [read_attacked(subject, trial, seed, picture, camera) for picture, camera in pictures]
        if not trial.chain:
            seconds["model" if trial.kind == "model" else "picture"] = statistics.median(r.seconds for r in runs)
        claims = [run.claim for run in runs]
        attacks[trial.label] = {
            "z": min(claim.z for claim in claims),
            "usual_z": statistics.fmean(claim.z for claim in claims),
            "bit_accuracy": min(claim.bit_accuracy for claim in claims),
            "matching": sum(claim.matching_bits for claim in claims),
            "read": sum(claim.bits for claim in claims),
            "log10_false_claim": max(claim.log10_false_claim for claim in claims),
        }
    return {"attacks": attacks, "verify_seconds": seconds}


def rehearse(model: GaussianModel, key: OwnerKey, config: EmbedConfig, original_sha256: str) -> Rehearsal:
    """What a mark on the unpruned model promises, planned on small views of the key."""
    small = replace(config, view_size=CONFIG.auto.view_size)
    whole = replace(small, prune=replace(small.prune, budget_db=None))
    ground = lay_groundwork(model, key, original_sha256, whole)
    draft = Draft(deliver(ground, whole, Clock()), PLAIN, key, copied=False)
    return Rehearsing(draft).at(draft.settle(whole))
