"""What is swept: every attack of the simulator in every reading, its strengths in order from harmless to ruinous.

A sweep's rows tell bits by both decoders and by the baselines, z, claim, and what the attacker paid. Extraction is
informed, the QIM baseline's excepted.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache, partial
from itertools import product
from typing import Any, Literal

import numpy as np

from engine.errors import InputError
from engine.flows.verify.decision import Reading, VerifyConfig, judge
from engine.flows.verify.search import Verification, verify_images, verify_model
from engine.lab.evaluate.baselines.method import Kept
from engine.lab.evaluate.baselines.methods import METHODS
from engine.lab.evaluate.baselines.picture_marks import FittedPictures
from engine.lab.evaluate.bench.attacks import to_8_bit
from engine.lab.evaluate.marked_scene import MarkedScene, bench_key
from engine.lab.evaluate.marked_subjects import fast_mark, picture_of
from engine.lab.evaluate.study import Row
from engine.lab.sim.adversaries.collusion import NEED_COPIES
from engine.lab.sim.attack import Label, Strength
from engine.lab.sim.attack_cost import image_cost, model_cost
from engine.lab.sim.attacks import IMAGE_ATTACKS, MODEL_ATTACKS
from engine.lab.sim.suite import Trial, apply_chain
from engine.model import Camera, Float32, Float64, GaussianModel

__all__ = ["Sweep", "all_sweeps", "branches", "picture_at_key_view", "sweep", "thinned"]

Kind = Literal["model", "image"]

STEPS = 5
"""Strengths of one sweep, at most; its grid's ends are always among them."""
LEFT_OUT = ("transplant",)
"""Frames another model and removes nothing: the study `null` has it."""
BASELINES = {"model": ("qim", "spread"), "image": ("dct",)}
"""Those that read models, whose marks are there at once, and one that reads pictures."""
PICTURE_DB = 35.0
"""At which the one that reads pictures marks: at our PSNR it does not read its own renders whole."""
PICTURE_SIZE = 400
"""Side of an attacked picture, pixels: a small one, as found on the web."""
UNCHANGED_DB = 80.0
"""Stands for this PSNR and all above, infinity included."""
MOVES_ONLY = {
    "crop_image",
    "mirror_image",
    "rotate_image",
    "scale_image",
    "lens_radial",
    "lens_brown",
    "lens_fisheye",
    "rolling_shutter",
}
"""Attacks on pictures that only move or cut pixels: no PSNR says what they cost."""


@dataclass(frozen=True)
class Sweep:
    """One attack of `engine.lab.sim.attacks`, in one reading and one direction, over its strengths."""

    attack: str
    kind: Kind
    reading: Label
    direction: str  # "", or "down" and "up": which side of the neutral strength, for attacks that have two
    strengths: tuple[Strength, ...]  # from harmless to ruinous; names are kinds and have no order

    @property
    def name(self) -> str:
        """In tables, figures and names of cells."""
        parts = [self.attack, self.direction, "as_code" if self.reading == "as_code" else ""]
        return "-".join(part for part in parts if part)


def all_sweeps() -> list[Sweep]:
    """Every attack but those that remove nothing, every reading, each side of the neutral strength."""
    attacks: list[Any] = [*MODEL_ATTACKS.values(), *IMAGE_ATTACKS.values()]
    return [
        Sweep(attack.name, attack.kind, reading.label, direction, thinned(strengths))
        for attack in attacks
        if attack.name not in LEFT_OUT
        for reading in attack.readings
        for direction, strengths in branches(reading.grid).items()
    ]


def branches(grid: tuple[Strength, ...]) -> dict[str, tuple[Strength, ...]]:
    """A grid as one or two runs of strengths from harmless to ruinous.

    Grids that go to both sides alternate: factors about 1, and signed strengths about 0.
    """
    numbers = [value for value in grid if not isinstance(value, str)]
    steps = np.diff(numbers)
    if len(numbers) < len(grid) or (steps > 0).all() or (steps < 0).all():
        return {"": grid}
    neutral = 0.0 if min(numbers) < 0 else 1.0
    return {
        "down": tuple(sorted((v for v in numbers if v < neutral), reverse=True)),
        "up": tuple(sorted(v for v in numbers if v > neutral)),
    }


def thinned(strengths: tuple[Strength, ...], most: int = STEPS) -> tuple[Strength, ...]:
    """At most so many of them, evenly spread, both ends kept. Kinds (names) all stay."""
    if any(isinstance(value, str) for value in strengths) or len(strengths) <= most:
        return strengths
    return tuple(strengths[round(k)] for k in np.linspace(0, len(strengths) - 1, most))


@lru_cache(maxsize=1)
def _baselines(path: str, kind: Kind, quick: bool, seed: int) -> dict[str, tuple[GaussianModel, Kept]]:
    """The scene marked by other methods with the same message in the same views; models at our PSNR."""
    scene = fast_mark(path, quick, seed)
    db = PICTURE_DB if kind == "image" else scene.report["psnr_worst_view"]
    wanted = (scene.opened.message, db, scene.opened.cameras)
    return {name: METHODS[name].embed(scene.original, bench_key(seed), *wanted) for name in BASELINES[kind]}


def sweep(
    path: str, attack: str, kind: Kind, reading: Label, strengths: list[Strength], trials: int, quick: bool, seed: int
) -> list[Row]:
    """Rows of an attack, one for each strength and trial, which has a key and a seed of its own.

    Of a model the Gaussians are read; where that gives no claim, the first trial's renders are looked at once, too.
    A picture is one from a key view.
    """
    scenes = [fast_mark(path, quick, seed + k) for k in range(trials)]
    rows: list[Row] = []
    looked = quick
    for (step, strength), (number, scene) in product(enumerate(strengths), enumerate(scenes)):
        row: Row = {"what": "sweep", "scene": scene.name, "attack": attack, "kind": kind, "reading": reading}
        row |= {"strength": strength, "step": step, "trial": number, "key": seed + number}
        rows.append(row)
        copies = tuple(other.marked for other in scenes if other is not scene) if attack in NEED_COPIES else ()
        trial = Trial(attack, ((attack, strength),), "", kind, reading)
        hurt = partial(apply_chain, trial=trial, seed=number, others=copies)
        camera, picture = picture_at_key_view(scene, number)
        try:
            suspect = hurt(picture if kind == "image" else scene.marked)
        except InputError as refusal:
            row["refused"] = str(refusal)
            continue
        if kind == "image":
            suspect = to_8_bit(suspect)
            row |= _said(verify_images([suspect], scene.opened, VerifyConfig(seed=number), cameras=[camera]), scene)
            if suspect.shape == picture.shape and attack not in MOVES_ONLY:
                row["psnr"] = min(image_cost(picture, suspect).psnr, UNCHANGED_DB)
            if not number:
                row |= _of_baselines(path, kind, quick, seed, hurt)
            continue
        row |= _said(verify_model(suspect, scene.opened, VerifyConfig(route="model", seed=number)), scene)
        if number:
            continue
        row |= _model_cost(scene, suspect, attack, quick)
        if attack not in NEED_COPIES:  # of a baseline there are no other copies to collude with
            row |= _of_baselines(path, kind, quick, seed, hurt)
        if not row["claimed"] and not looked:
            looked = True
            row["z_by_looking"] = verify_model(suspect, scene.opened, VerifyConfig(route="render")).claim.z
    return rows


def _of_baselines(path: str, kind: Kind, quick: bool, seed: int, hurt: Callable[..., Any]) -> Row:
    """Bits that the baselines read after the same attack; a picture is one of theirs that is read best."""
    message, rows = fast_mark(path, quick, seed).opened.message, Row()
    for name, (model, kept) in _baselines(path, kind, quick, seed).items():
        method = METHODS[name]
        if isinstance(method, FittedPictures):
            shown = picture_of(model, method.cameras(kept.original)[0])
            scores: Float64 | None = method.read_picture(to_8_bit(hurt(shown)), kept)
        else:
            scores = method.read_model(hurt(model), kept)
        rows[f"bits_{name}"] = None if scores is None else float((np.where(scores >= 0, 1, -1) == message).mean())
    return rows


@lru_cache(maxsize=4)
def picture_at_key_view(scene: MarkedScene, number: int = 0) -> tuple[Camera, Float32]:
    """A small picture of a marked model at one of the owner's views, and its camera."""
    cameras = scene.opened.cameras
    camera = cameras[number % len(cameras)].resized(PICTURE_SIZE, PICTURE_SIZE)
    return camera, picture_of(scene.marked, camera)


def _said(result: Verification, scene: MarkedScene) -> Row:
    """What the verification answered, and the bits by the paper's rule from the very same evidence."""
    claim = result.claim
    read = Reading(claim.route, result.evidence)
    paper = judge(read, scene.opened, VerifyConfig(decoder="paper"), claim.tries)
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
