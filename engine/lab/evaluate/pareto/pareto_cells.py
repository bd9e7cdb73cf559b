"""One setting on one scene: processor seconds, bytes, decibels, and what is read after attacks."""

import time
from collections.abc import Sequence
from functools import lru_cache
from pathlib import Path

from engine.flows.embed.embedding import embed
from engine.flows.embed.profiles import AUTO, compose, delivered_as, profile
from engine.flows.records.opened_record import open_record
from engine.formats import LoadedModel, encode_model, read_model
from engine.lab.evaluate.bench.attacks import other_views, read_attacked, to_8_bit
from engine.lab.evaluate.marked_scene import MarkedScene, bench_key
from engine.lab.evaluate.study import Row
from engine.lab.sim.suite import Trial
from engine.model import Camera, Float32
from engine.numerics.image_metrics import psnr
from engine.raster import render
from engine.watermark.rates import MADE_FIRST

SETTINGS: dict[str, tuple[str, float | None, tuple[str, ...]]] = {
    "fast": ("fast", None, ()),
    "balanced": ("balanced", None, ()),
    "strong": ("strong", None, ()),
    "auto": (AUTO, None, ()),
    "auto, 40 dB": (AUTO, 40.0, ()),
    "auto, 40 dB, no recovery": (AUTO, 40.0, ("prune.recover=false",)),
    "paper": ("paper", None, ()),
}
"""Profile, pruning budget and knobs by the name on the chart; `paper` is the paper's system as we run it."""
QUICK = ("fast", "auto")
ATTACKS = (
    Trial("crop to 10 %", (("crop", 0.1),), "", "model"),
    Trial("noise 0.1 on all", (("noise_all", 0.1),), "", "model"),
    Trial(".splat and back", (("convert", "splat"),), "", "model"),
    Trial("picture, JPEG 10", (("jpeg", 10),), "", "image"),
    Trial("picture, noise 0.1", (("noise_image", 0.1),), "", "image"),
)
"""What every setting is put through; one picture a claim, its camera known."""
UNSEEN, SIDE = 6, 800
"""Views that no key view was, pixels a side; the first PICTURES of them are attacked."""
PICTURES = 2
OF_VIEWS = 0x4E1D
"""Of the stream that draws those views."""


def measure_setting(scene: str, setting: str, seed: int, quick: bool) -> list[Row]:
    """Everything about one of SETTINGS on one scene; quick: without landmarks, one small view."""
    loaded, key = _warm(scene), bench_key(seed)
    name, budget, knobs = SETTINGS[setting]
    config = compose(name, budget_db=budget, knobs=(*knobs, "landmark_views=0", "view_size=256") if quick else knobs)
    began = time.process_time()
    made = embed(loaded.model, key, original_sha256=loaded.sha256, config=delivered_as(config, "sog"))
    seconds = time.process_time() - began
    subject = MarkedScene(
        Path(scene).name, loaded.model, made.model, open_record(made.record.to_bytes(key), key, MADE_FIRST), made.report
    )
    cameras = other_views(loaded.model, 1 if quick else UNSEEN, 256 if quick else SIDE, (seed, OF_VIEWS))
    views = [render(made.model, camera) for camera in cameras]
    pictures = [(to_8_bit(view), camera) for view, camera in zip(views[:PICTURES], cameras, strict=False)]
    return [
        {
            "scene": subject.name,
            "setting": setting,
            "cpu_seconds": seconds,
            "stages": made.report.seconds_by_stage,
            "bytes": len(encode_model(made.model, "sog")),
            "bytes_whole": len(encode_model(loaded.model, "sog")),
            "gaussians": made.report.gaussians_in,
            "gaussians_out": made.report.gaussians_out,
            "psnr_unseen": min(
                psnr(render(loaded.model, camera), view) for view, camera in zip(views, cameras, strict=True)
            ),
            "psnr_of_mark": made.report.psnr_worst_view,
            **_attacked(subject, pictures, seed),
        }
    ]


def _attacked(subject: MarkedScene, pictures: Sequence[tuple[Float32, Camera]], seed: int) -> Row:
    z, right = dict[str, float](), dict[str, float]()
    for trial in ATTACKS:
        if trial.kind == "image":
            claims = [read_attacked(subject, trial, seed, *picture).claim for picture in pictures]
        else:
            claims = [read_attacked(subject, trial, seed, subject.marked).claim]
        z[trial.label] = min(claim.z for claim in claims)
        right[trial.label] = min(claim.bit_accuracy for claim in claims)
    worst = min(z, key=z.__getitem__)
    return {"z": z, "worst_z": z[worst], "worst_attack": worst, "bits_right": min(right.values())}


@lru_cache(maxsize=1)
def _warm(scene: str) -> LoadedModel:
    """The scene, once an embedding of it has paid for what later ones of the process find ready."""
    loaded = read_model(scene)
    small = profile("fast", views=2, view_size=128, landmark_views=2, psnr_db=40.0)
    embed(loaded.model, bench_key(0), original_sha256=loaded.sha256, bits=16, config=small)
    return loaded
