"""Cells of the tables: scenes marked by a setting, attacked and timed; what the model and pictures of it still say."""

import statistics
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from engine.errors import CapacityError
from engine.flows.verify.decision import Reading, VerifyConfig, judge
from engine.flows.verify.search import Verification, verify_model
from engine.formats import encode_model
from engine.lab.evaluate.bench.attacks import other_views, read_attacked, to_8_bit
from engine.lab.evaluate.bench.raster import bench_camera
from engine.lab.evaluate.bench.timing import seconds_of, spread
from engine.lab.evaluate.marked_scene import Changes, MarkedScene, configure, mark_scene
from engine.lab.evaluate.study import Row
from engine.lab.evaluate.tables.part import DEFAULT, Setting
from engine.lab.sim.attack import Label
from engine.lab.sim.multiscale_ssim import ms_ssim_distance
from engine.lab.sim.suite import Trial
from engine.model import Camera, Float32, GaussianModel
from engine.numerics.image_metrics import psnr, ssim
from engine.raster import render

UNTOUCHED = Trial("none", (), "", "image")
ATTACKS = (
    UNTOUCHED,
    Trial("JPEG 10", (("jpeg", 10),), "", "image"),
    Trial("noise 0.1", (("noise_image", 0.1),), "", "image"),
)
"""What single pictures go through where settings are compared."""
MOVED = {"rotation": ("rotate_image", 30.0), "scaling": ("scale_image", 0.75), "crop": ("crop_image", 0.4)}
ON_PICTURES: dict[Label, dict[str, tuple[str, float] | None]] = {
    "literal": {"none": None, **MOVED, "jpeg": ("jpeg", 10), "noise": ("noise_image", 0.1)},
    "as_code": {**MOVED, "noise": ("noise_image", 0.01)},
}
"""Table 2: reading -> column -> attack and strength. JPEG means quality 10 in both."""
ON_MODELS: dict[Label, dict[str, tuple[str, float] | None]] = {
    "literal": {
        "none": None,
        "rotation": ("rotate", 30.0),
        "scaling": ("scale", 0.75),
        "crop": ("crop", 0.6),
        "noise": ("noise_all", 0.1),
        "clone": ("clone", 0.5),
        "prune": ("prune_random", 0.2),
        "10 % left, random": ("prune_random", 0.9),
        "10 % left, one piece": ("crop", 0.1),
    },
    "as_code": {"crop": ("crop", 0.4), "clone": ("clone", 0.5)},
}
"""The same names for a model. As code: crop drops a block of the file, cloning copies Gaussians as they are."""
FORMATS = ("ply", "compressed.ply", "splat", "spz", "sog")
OF_VIEWS = 0x7AB1E
"""Of the stream that draws views."""
REPORTED = (
    "psnr_worst_view",
    "ssim_worst_view",
    "psnr_total_worst_view",
    "gaussians_in",
    "gaussians_out",
    "capacity_bits",
)


def measure_setting(
    scene: str, setting: dict[str, Any], seed: int, views: int, size: int, changes: Changes, attacked: bool
) -> list[Row]:
    """Mark a scene by a setting (fields of `Setting`, after the run's own changes) and look at it from other views.

    Rows are one ``"kind": "marked"`` (worst key view's fidelity, bits and z of the model itself, seconds), or
    ``"refused"`` with the reason; one ``"view"`` for each view (PSNR, SSIM, 1 - MS-SSIM against the original), and one
    ``"picture"`` for each view as it is or, `attacked`, for each view and each of ATTACKS.
    """
    chosen = Setting(**setting)
    about = {"scene": Path(scene).name, "setting": chosen.name, "seed": seed}
    try:
        marked = mark_setting(scene, chosen, seed, changes)
    except CapacityError as refusal:
        return [{**about, "kind": "refused", "reason": str(refusal), "capacity_bits": refusal.capacity}]
    shown = marked.original if chosen.unmarked else marked.marked
    whole = verify_model(shown, marked.opened, VerifyConfig(route="model"))
    rows: list[Row] = [
        {
            **about,
            "kind": "marked",
            **{name: marked.report[name] for name in REPORTED},
            **_read_bits(whole, marked, "model"),
            "embed_seconds": marked.report["seconds"],
            "refine_seconds": marked.report["seconds_by_stage"].get("refine", 0.0),
        }
    ]
    for view, camera in enumerate(other_views(marked.original, views, size, (seed, OF_VIEWS))):
        truth, picture = (np.clip(render(model, camera), 0.0, 1.0) for model in (marked.original, shown))
        look = {
            "psnr": psnr(truth, picture),
            "ssim": ssim(truth, picture),
            "distance": ms_ssim_distance(truth, picture),
        }
        rows.append({**about, "kind": "view", "view": view, **look})
        for reading in _of_picture(picture, camera, marked, ATTACKS if attacked else (UNTOUCHED,), (seed, view)):
            rows.append({**about, "kind": "picture", "view": view, **reading})
    return rows


def attack_pictures(
    scene: str,
    seed: int,
    views: int,
    size: int,
    changes: Changes,
    columns: list[str],
    setting: dict[str, Any] | None = None,
) -> list[Row]:
    """Attacks on one picture at a time, camera known; a row for each view, reading and column."""
    marked = mark_setting(scene, DEFAULT if setting is None else Setting(**setting), seed, changes)
    rows = []
    for view, camera in enumerate(other_views(marked.original, views, size, (seed, OF_VIEWS))):
        picture = render(marked.marked, camera)
        for number, (label, attacks) in enumerate(ON_PICTURES.items()):
            trials = (
                Trial(column, (step,) if step else (), "", "image", label)
                for column, step in attacks.items()
                if column in columns
            )
            about = {"scene": marked.name, "seed": seed, "on": "picture", "reading": label, "view": view}
            rows += [{**about, **row} for row in _of_picture(picture, camera, marked, trials, (seed, view, number))]
    return rows


def attack_models(
    scene: str, seed: int, changes: Changes, columns: list[str], setting: dict[str, Any] | None = None
) -> list[Row]:
    """Attacks on the marked model; a row for each reading and column."""
    marked = mark_setting(scene, DEFAULT if setting is None else Setting(**setting), seed, changes)
    rows = []
    for kind, (label, attacks) in enumerate(ON_MODELS.items()):
        for number, (column, step) in enumerate(attacks.items()):
            if column in columns:
                trial = Trial(column, (step,) if step else (), "", "model", label)
                result = read_attacked(marked, trial, (seed, kind, number), marked.marked)
                about = {"scene": marked.name, "seed": seed, "on": "model", "reading": label, "attack": column}
                rows.append({**about, **_read_bits(result, marked, "model")})
    return rows


def measure_costs(
    scene: str, profile: str, seed: int, repeats: int, width: int, height: int, changes: Changes
) -> list[Row]:
    """Table 3: seconds of `repeats` markings and verifications, one before them not timed where there are several.

    Also frames a second of width x height pixels without and with the mark, bytes in every format, and of "compact" as
    .sog.
    """
    warm = 1 if repeats > 1 else 0
    config = configure(profile, changes)
    scenes = [mark_scene(scene, config, seed=seed) for _ in range(repeats + warm)][warm:]
    made = scenes[-1]
    verifies = [verify_model(made.marked, made.opened).seconds for _ in range(repeats + warm)][warm:]
    compact = mark_scene(scene, replace(config, output="compact", landmark_views=0), seed=seed)
    camera = bench_camera(made.original, width, height)
    return [
        {
            "scene": made.name,
            "profile": profile,
            "gaussians": len(made.original),
            **spread([one.report["seconds"] for one in scenes], "embed"),
            **spread(verifies, "verify"),
            "fps_before": _frames(made.original, camera, repeats),
            "fps_after": _frames(made.marked, camera, repeats),
            "width": width,
            "height": height,
            "bytes": {kind: len(encode_model(made.marked, kind)) for kind in FORMATS},
            "compact_sog_bytes": len(encode_model(compact.marked, "sog")),
            "compact_psnr": compact.report["psnr_total_worst_view"],
        }
    ]


def _frames(model: GaussianModel, camera: Camera, repeats: int) -> float:
    """Frames a second: the median of `repeats` frames after one that is not timed."""
    render(model, camera)
    return 1.0 / statistics.median(seconds_of(lambda: render(model, camera)) for _ in range(max(repeats, 3)))


def mark_setting(scene: str, setting: Setting, seed: int, changes: Changes) -> MarkedScene:
    """The scene marked by a setting, after the run's own changes."""
    config = configure(setting.profile, changes, setting.changes)
    return mark_scene(scene, config, bits=setting.bits, seed=seed)


def _read_bits(result: Verification, scene: MarkedScene, route: str) -> Row:
    """Bits by our decoder and by the paper's rule (Eq 10), and the claim, from one reading."""
    claim = result.claim
    paper = judge(Reading(route, result.evidence), scene.opened, VerifyConfig(decoder="paper"))
    return {
        "z": claim.z,
        "right": claim.matching_bits,
        "bits": claim.bits,
        "right_by_eq10": paper.matching_bits,
        "claimed": claim.verdict.value == "marked",
        "log10_false_claim": claim.log10_false_claim,
        "seconds": result.seconds,
    }


def _of_picture(
    picture: Float32, camera: Camera, scene: MarkedScene, trials: Iterable[Trial], seed: Sequence[int]
) -> Iterator[Row]:
    """A claim, and the ``attack``, from each attacked version of a picture whose camera is known."""
    stored = to_8_bit(picture)
    for number, trial in enumerate(trials):
        result = read_attacked(scene, trial, (*seed, number), stored, camera)
        yield {"attack": trial.label, **_read_bits(result, scene, "image")}
