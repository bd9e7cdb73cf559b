"""One sweep on one scene: bits by both decoders and by the baselines, z, claim, and what the attacker paid.

Extraction is informed, the QIM baseline's excepted.
"""

from typing import Any

import numpy as np

from engine.errors import InputError
from engine.evaluate.bench.attacks import to_8_bit
from engine.evaluate.marked_scene import MarkedScene
from engine.evaluate.stability.subjects import BaselineMark, Subjects, subjects
from engine.evaluate.study import Row
from engine.model import Float32, GaussianModel
from engine.pipeline.judging import VerifyConfig, judge
from engine.pipeline.verification import Verification, verify_images, verify_model
from engine.raster import render
from engine.sim.attack import Label, Strength
from engine.sim.cost import image_cost, model_cost
from engine.sim.suite import Company, Trial, apply_chain

__all__ = ["sweep_images", "sweep_models"]

PICTURE_SIZE = 400
"""Side of an attacked picture, pixels: a small one, as found on the web."""
UNCHANGED_DB = 80.0
"""Stands for this PSNR and all above, infinity included."""
MOVES_ONLY = {
    "crop_image",
    "rotate_image",
    "scale_image",
    "lens_radial",
    "lens_brown",
    "lens_fisheye",
    "rolling_shutter",
}
"""Attacks on pictures that only move or cut pixels: no PSNR says what they cost."""


def sweep_models(
    path: str, attack: str, reading: Label, strengths: list[Strength], trials: int, quick: bool, seed: int
) -> list[Row]:
    """Rows of an attack on models, one for each strength and trial; each trial has a key and a seed of its own.

    The Gaussians are read; where that gives no claim, the first trial's renders are looked at once, too.
    """
    marked = subjects(path, trials, quick, seed)
    rows: list[Row] = []
    looked = False
    for step, strength in enumerate(strengths):
        for number, scene in enumerate(marked.trials):
            about = {**_about(scene, attack, "model", reading, strength, step, number), "key": seed + number}
            try:
                suspect = _attacked(scene.marked, attack, reading, strength, number, marked)
            except InputError as refusal:
                rows.append({**about, "refused": str(refusal)})
                continue
            result = verify_model(suspect, scene.opened, VerifyConfig(route="model", seed=number))
            row = {**about, **_said(result, scene)}
            if number == 0:
                row |= _model_cost(scene, suspect, attack, quick)
                row |= {
                    f"bits_{mark.name}": _bits_of(mark, scene, attack, reading, strength, marked)
                    for mark in marked.baselines
                }
                if not row["claimed"] and not looked and not quick:
                    looked = True
                    again = verify_model(suspect, scene.opened, VerifyConfig(route="render"))
                    row["z_by_looking"] = again.claim.z
            rows.append(row)
    return rows


def sweep_images(
    path: str, attack: str, reading: Label, strengths: list[Strength], trials: int, quick: bool, seed: int
) -> list[Row]:
    """Rows of an attack on one picture from a key view, one for each strength and trial (key, view and seed)."""
    marked = subjects(path, trials, quick, seed)
    rows: list[Row] = []
    for number, scene in enumerate(marked.trials):
        cameras = scene.opened.cameras
        camera = cameras[number % len(cameras)].resized(PICTURE_SIZE, PICTURE_SIZE)
        picture = to_8_bit(render(scene.marked, camera))
        for step, strength in enumerate(strengths):
            about = {**_about(scene, attack, "image", reading, strength, step, number), "key": seed + number}
            try:
                suspect = to_8_bit(_attacked(picture, attack, reading, strength, number, None))
            except InputError as refusal:
                rows.append({**about, "refused": str(refusal)})
                continue
            result = verify_images([suspect], scene.opened, VerifyConfig(seed=number), cameras=[camera])
            row = {**about, **_said(result, scene)}
            if suspect.shape == picture.shape and attack not in MOVES_ONLY:
                row["psnr"] = min(image_cost(picture, suspect).psnr, UNCHANGED_DB)
            rows.append(row)
    return rows


def _about(scene: MarkedScene, attack: str, kind: str, reading: str, strength: Strength, step: int, trial: int) -> Row:
    return {
        "what": "sweep",
        "scene": scene.name,
        "attack": attack,
        "kind": kind,
        "reading": reading,
        "strength": strength,
        "step": step,
        "trial": trial,
    }


def _attacked(
    target: GaussianModel | Float32,
    attack: str,
    reading: Label,
    strength: Strength,
    seed: int,
    marked: Subjects | None,
    judged: bool = False,
) -> Any:
    kind = "image" if isinstance(target, np.ndarray) else "model"
    copies: tuple[GaussianModel, ...] = ()
    if marked is not None and attack == "collude":
        copies = tuple(scene.marked for scene in marked.trials if scene.marked is not target)
    trial = Trial(attack, ((attack, strength),), "", "image" if kind == "image" else "model", reading, len(copies))
    return apply_chain(target, trial, seed, company=Company(copies))


def _said(result: Verification, scene: MarkedScene) -> Row:
    """What the verification answered, and the bits by the paper's rule from the very same evidence."""
    claim = result.claim
    paper = judge(result.evidence, scene.opened, claim.route, claim.tries, VerifyConfig(decoder="paper"))
    return {
        "bits": claim.bit_accuracy,
        "bits_paper": paper.bit_accuracy,
        "message_bits": claim.bits,
        "z": claim.z,
        "z_threshold": claim.z_threshold,
        "claimed": claim.verdict.value == "marked",
        "verdict": claim.verdict.value,
        "log10_false_claim": claim.log10_false_claim,
    }


def _model_cost(scene: MarkedScene, suspect: GaussianModel, attack: str, quick: bool) -> Row:
    """The look that is left: of a model that was cut, where it still stands, as the coverage says."""
    if attack == "merge_into":  # what surrounds the stolen model is no loss of its look
        return {}
    cost = model_cost(scene.marked, suspect, views=2 if quick else 4, size=200 if quick else 400)
    look = cost.psnr if cost.covered_psnr is None else max(cost.psnr, cost.covered_psnr)
    return {"psnr": min(look, UNCHANGED_DB), "coverage": cost.coverage}


def _bits_of(
    mark: BaselineMark, scene: MarkedScene, attack: str, reading: Label, strength: Strength, marked: Subjects
) -> float | None:
    """Share of a baseline's bits read after the same attack on its own marked model."""
    if attack == "collude":  # its other copies were not made
        return None
    scores = mark.read(_attacked(mark.model, attack, reading, strength, 0, marked))
    if scores is None:
        return None
    return float(np.mean(np.where(scores >= 0, 1, -1) == scene.opened.message))
