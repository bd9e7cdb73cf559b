"""One method on one scene under one key: fidelity, attacks on the model and on single pictures, wrong keys."""

import time
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from engine.flows.verify.search import VerifyConfig, verify_images, verify_model
from engine.flows.views.camera_rig import make_rig
from engine.formats import read_model
from engine.lab.evaluate.baselines.method import Kept, Method
from engine.lab.evaluate.baselines.methods import find_method
from engine.lab.evaluate.baselines.picture_marks import FittedPictures
from engine.lab.evaluate.bench.attacks import IMAGE_BARS, MODEL_BARS, to_8_bit
from engine.lab.evaluate.bench.truth import wrong_key_rates
from engine.lab.evaluate.marked_scene import bench_key
from engine.lab.evaluate.marked_subjects import fast_config, fast_mark, picture_of
from engine.lab.evaluate.study import Row
from engine.lab.sim.attacks import image_attack
from engine.lab.sim.suite import Trial, apply_chain
from engine.model import Camera, Float32, Float64, GaussianModel
from engine.numerics.image_metrics import psnr, ssim
from engine.raster import render
from engine.watermark.keys import POSE, OwnerKey, uniform
from engine.watermark.messages import Signs, derive_message

__all__ = ["BITS", "LEAST_MATCHES", "attack_baseline", "attack_ours"]

BITS = 32
LEAST_MATCHES = 26
"""Of 32 bits: what the field's usual test at 1e-3 requires, if wrong keys read fair and independent bits."""
QUICK_ATTACKS = ("none", "prune random 20 %", "similarity x10 + shuffle", "JPEG 10")


def attack_baseline(path: str, method: str, seed: int, pictures: int, wrong_keys: int, quick: bool) -> list[Row]:
    """Mark a scene by another method at our PSNR, in the views where ours would have been measured, and attack it.

    Image attacks are tried on so many single `pictures`; the seed is of the key, and attacks have streams of their own.
    ``what`` of a row is "embedding", "attack" or "wrong keys"; one row "skipped" where the method cannot run here.
    """
    chosen, about = find_method(method), {"scene": Path(path).name, "method": method, "seed": seed}
    if reason := chosen.missing():
        return [{**about, "what": "skipped", "reason": reason}]
    if quick and isinstance(chosen, FittedPictures):
        chosen = replace(chosen, views=4, size=256, epochs=4, read_views=2)
    original, key = read_model(path).model, bench_key(seed)
    message, views = derive_message(key, BITS, method.encode()), _views(original, key, quick)
    began = time.perf_counter()
    marked, kept = chosen.embed(original, key, message, fast_config(quick).psnr_db, views)
    seconds = time.perf_counter() - began
    rows = [_embedding(seconds, kept.strength, original, marked, views)]
    for name, suspect in _attacked_models(marked, quick):
        rows.append(_read("model", name, chosen.read_model(suspect, kept), message))
    for name, picture in _attacked_pictures(marked, chosen.cameras(original)[:pictures], quick):
        rows.append(_read("picture", name, chosen.read_picture(picture, kept), message))
    rows.append({"what": "wrong keys", **_wrong_keys(chosen, original, marked, kept, message, wrong_keys)})
    return [{**about, **row} for row in rows]


def attack_ours(path: str, seed: int, pictures: int, quick: bool) -> list[Row]:
    """The same attacks on our mark, read with the record.

    Parameters and rows as for `attack_baseline`; rows of attacks also tell whether the claim held.
    """
    scene = fast_mark(path, quick, seed)
    opened = scene.opened
    rows = [_embedding(scene.report["seconds"], opened.strength, scene.original, scene.marked, opened.cameras)]
    for name, suspect in _attacked_models(scene.marked, quick):
        claim = verify_model(suspect, opened, VerifyConfig(route="model")).claim
        rows.append(_attack("model", name, claim.matching_bits, claim.verdict.value == "marked"))
    for camera in opened.cameras[:pictures]:
        for name, picture in _attacked_pictures(scene.marked, [camera], quick):
            claim = verify_images([picture], opened, VerifyConfig(), cameras=[camera]).claim
            rows.append(_attack("picture", name, claim.matching_bits, claim.verdict.value == "marked"))
    for rates in wrong_key_rates(scene, 1_000 if quick else 10_000, seed):
        rate_row = {field: rates[field] for field in ("route", "keys", "largest_z")}
        rows.append({"what": "wrong keys", **rate_row, "accepted": rates["claims_at_1e-9"]})
    return [{"scene": Path(path).name, "method": "ours", "seed": seed, **row} for row in rows]


def _embedding(
    seconds: float, strength: float, original: GaussianModel, marked: GaussianModel, cameras: Sequence[Camera]
) -> Row:
    pairs = [(render(original, camera), render(marked, camera)) for camera in cameras]
    fidelity = {"psnr": min(psnr(a, b) for a, b in pairs), "ssim": min(ssim(a, b) for a, b in pairs)}
    return {"what": "embedding", "seconds": seconds, "strength": strength, **fidelity}


def _attack(on: str, name: str, right: int | None, claimed: bool | None) -> Row:
    return {"what": "attack", "on": on, "attack": name, "right": right, "claimed": claimed}


def _read(on: str, name: str, scores: Float64 | None, message: Signs) -> Row:
    right = _matching(scores, message)
    return _attack(on, name, right, None if right is None else right >= LEAST_MATCHES)


def _matching(scores: Float64 | None, message: Signs) -> int | None:
    """Bits read right; None for a method that cannot read such a thing."""
    return None if scores is None else int((np.where(scores >= 0, 1, -1) == message).sum())


def _views(model: GaussianModel, key: OwnerKey, quick: bool) -> list[Camera]:
    """Key views drawn as ours are: the PSNR of all methods is that of the worst of such views."""
    config = fast_config(quick)
    jitter = uniform(key.derive(POSE, b"baseline"), 4 * config.views).reshape(config.views, 4)
    return make_rig(model, config.views, config.view_size, config.view_size, jitter=jitter)


def _attacked_models(marked: GaussianModel, quick: bool) -> Iterator[tuple[str, GaussianModel]]:
    for name, chain in MODEL_BARS:
        if not quick or name in QUICK_ATTACKS:
            yield name, apply_chain(marked, Trial(name, chain, "bars"), 0)


def _attacked_pictures(marked: GaussianModel, cameras: Sequence[Camera], quick: bool) -> Iterator[tuple[str, Float32]]:
    for number, camera in enumerate(cameras):
        picture = picture_of(marked, camera)
        for name, attack, strength in (("none", "", 0.0), *IMAGE_BARS):
            if quick and name not in QUICK_ATTACKS:
                continue
            rng = np.random.default_rng((0, number))
            yield name, to_8_bit(image_attack(attack).apply(picture, strength, rng=rng)) if attack else picture


def _wrong_keys(
    method: Method, original: GaussianModel, marked: GaussianModel, kept: Kept, message: Signs, count: int
) -> dict[str, int | list[int] | None]:
    """How many bits of other owners' messages their keys read from the marked model, and ours from the unmarked one."""
    own = method.read_model(marked, kept)
    matches: list[int] = []
    for number in range(count):
        key = bench_key(10_000 + number)
        scores = method.read_model(marked, replace(kept, key=key)) if method.keyed else own
        matches.append(_matching(scores, derive_message(key, BITS, b"another")) or 0)
    return {
        "keys": count,
        "matches": matches,
        "most_matches": max(matches),
        "accepted": sum(value >= LEAST_MATCHES for value in matches),
        "unmarked_matches": _matching(method.read_model(original, kept), message),
    }
