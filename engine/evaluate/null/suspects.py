"""Suspects that no key without a part in them may claim: marked by others, unmarked, or made to deceive."""

from collections.abc import Callable, Iterator, Sequence
from functools import lru_cache
from pathlib import Path

import numpy as np

from engine.evaluate.bench.attacks import to_8_bit
from engine.evaluate.bench.truth import innocent_copies
from engine.evaluate.marked_scene import MarkedScene, bench_key, mark_scene
from engine.evaluate.null.counting import above, count_wrong_keys, wrong_key_seed
from engine.evaluate.study import Row
from engine.formats import read_model
from engine.model import Float64, GaussianModel
from engine.pipeline.embedding import embed
from engine.pipeline.profiles import EmbedConfig, profile
from engine.pipeline.sealing import open_record
from engine.pipeline.strength import add_dc
from engine.pipeline.verification import Verification, VerifyConfig, verify_images, verify_model
from engine.raster import render
from engine.sim.attacks import model_attack
from engine.watermark.copies import copies_z, copy_mark

__all__ = ["FOUND", "config_of", "marked_scene", "try_copies", "try_crafted", "try_found", "try_pairs"]

BITS = 32
FOUND = {
    "marked": "marked by the owner",
    "noised": "marked, noise 0.1",
    "unmarked": "unmarked",
    "foreign": "marked by another key",
}
LOUD = 40
"""Code vectors that drown all others in one of the crafted suspects."""


def config_of(quick: bool) -> EmbedConfig:
    """Profile fast without landmarks; smaller and fewer views in a quick run."""
    if quick:
        return profile("fast", landmark_views=0, views=3, view_size=400)
    return profile("fast", landmark_views=0)


@lru_cache(maxsize=2)
def marked_scene(path: str, quick: bool, seed: int) -> MarkedScene:
    """A scene marked with 32 bits, made once for each process."""
    return mark_scene(path, config_of(quick), bits=BITS, seed=seed)


def _row(what: str, scene: MarkedScene, name: str, result: Verification, keys: int, seed: int, own: bool) -> Row:
    """One suspect: what the record itself answered, and how far wrong keys came on the same evidence."""
    evidence, claim = result.evidence, result.claim
    counted = count_wrong_keys(evidence.y, evidence.weights, keys, wrong_key_seed(scene.name, name, claim.route, seed))
    return {
        "what": "null",
        "group": what,
        "scene": scene.name,
        "suspect": name,
        "route": claim.route,
        "carries": own,
        "z_own": claim.z,
        "verdict": claim.verdict.value,
        **counted,
    }


def _routes(scene: MarkedScene, suspect: GaussianModel, routes: Sequence[str]) -> Iterator[Verification]:
    for route in routes:
        if route != "image":
            yield verify_model(suspect, scene.opened, VerifyConfig(route=route))
            continue
        camera = scene.opened.cameras[0]
        yield verify_images([to_8_bit(render(suspect, camera))], scene.opened, cameras=[camera])


def try_found(path: str, name: str, keys: int, quick: bool, seed: int) -> list[Row]:
    """Wrong keys on all evidence of a model that turned up.

    Parameters
    ----------
    name : {"marked", "noised", "unmarked", "foreign"}
        The owner's; the same with noise of 0.1 on every attribute; the original; marked by another key.
    quick : bool
        The Gaussians alone; of the marked model one picture, too.
    """
    scene = marked_scene(path, quick, seed)
    if name == "foreign":
        suspect = marked_scene(path, quick, seed + 1).marked
    elif name == "noised":
        suspect = model_attack("noise_all").apply(scene.marked, 0.1, rng=seed)
    else:
        suspect = {"marked": scene.marked, "unmarked": scene.original}[name]
    routes = ["model", "render", "image"]
    if quick:
        routes = ["model", "image"] if name == "marked" else ["model"]
    return [
        _row("found", scene, FOUND[name], result, keys, seed, name in ("marked", "noised"))
        for result in _routes(scene, suspect, routes)
    ]


def try_crafted(path: str, keys: int, quick: bool, seed: int) -> list[Row]:
    """Suspects made to deceive the detector by someone who knows the reference and its code vectors, but no chip."""
    scene = marked_scene(path, quick, seed)
    opened, layout = scene.opened, scene.opened.layout
    reference, amplitudes = opened.reference, opened.strength * opened.layout.amplitudes
    rng = np.random.default_rng((seed, 0xADE))
    read = verify_model(scene.marked, opened, VerifyConfig(route="model")).evidence
    sharpened = np.sign(read.y) * np.median(np.abs(read.y))

    def loud(count: int, factor: float) -> Float64:
        chosen = np.zeros(layout.chips)
        at = rng.choice(layout.chips, count, replace=False)
        chosen[at] = factor * amplitudes[at] * rng.choice([-1.0, 1.0], count)
        return chosen

    one = reference.sh.copy()
    one[len(one) // 2, 0] += 50.0
    displaced: dict[str, Callable[[], Float64]] = {
        "every chip at its full strength, guessed signs": lambda: amplitudes * rng.choice([-1.0, 1.0], layout.chips),
        "every chip pushed the same way": lambda: amplitudes,
        "normal noise along the carriers": lambda: amplitudes * rng.standard_normal(layout.chips),
        "heavy-tailed noise along the carriers": lambda: amplitudes * rng.standard_cauchy(layout.chips).clip(-300, 300),
        f"{LOUD} code vectors drown the others": lambda: loud(LOUD, 100.0),
        "one code vector drowns the others": lambda: loud(1, 1000.0),
    }
    suspects = {
        name: (reference.with_(sh=add_dc(reference.sh, layout.displace(make()))), False)
        for name, make in displaced.items()
    }
    suspects["one Gaussian dominates"] = (reference.with_(sh=one), False)
    # Owner's mark, every chip made equally loud: still his, so only wrong keys are counted.
    suspects["owner's evidence sharpened"] = (
        reference.with_(sh=add_dc(reference.sh, layout.displace(sharpened))),
        True,
    )
    return [
        _row("crafted", scene, name, verify_model(suspect, opened, VerifyConfig(route="model")), keys, seed, own)
        for name, (suspect, own) in suspects.items()
    ]


def try_copies(path: str, copies: int, quick: bool, seed: int) -> list[Row]:
    """Records of recipients who had no part, drawn by the real key derivation, on one recipient's copy."""
    loaded, key = read_model(path), bench_key(seed)
    made = embed(loaded.model, key, original_sha256=loaded.sha256, bits=BITS, config=config_of(quick), copy="guilty")
    opened = open_record(made.record.to_bytes(key), key)
    result = verify_model(made.model, opened, VerifyConfig(route="model"))
    marks = [
        copy_mark(record.header.record_id, record.copy, record.spreading, record.message)
        for record in innocent_copies(opened, key, copies)
    ]
    z = copies_z(result.evidence.y, result.evidence.weights, marks)
    return [
        {
            "what": "null",
            "group": "copies",
            "scene": Path(path).name,
            "suspect": "copies of other recipients",
            "route": "model",
            "carries": False,
            "z_own": float(z.max()),
            "verdict": "marked" if result.claim.z_threshold <= z.max() else "not_marked",
            "keys": copies,
            "hits": above(z),
            "z_largest": float(z.max()),
            "z_mean": float(z.mean()),
            "z_std": float(z.std()),
        }
    ]


def try_pairs(path: str, other: str, quick: bool, seed: int) -> list[Row]:
    """This scene's record against another scene: unmarked, marked, and with this scene's mark lifted onto it."""
    scene = marked_scene(path, quick, seed)
    foreign = marked_scene(other, quick, seed + 1)
    lifted = model_attack("transplant").apply(foreign.original, 1.0, rng=seed, source=scene.marked)
    suspects = {"unmarked": foreign.original, "marked": foreign.marked, "with this mark lifted onto it": lifted}
    rows = []
    for name, suspect in suspects.items():
        result = verify_model(suspect, scene.opened, VerifyConfig(route="model"))
        rows.append(_row("other scene", scene, f"{foreign.name} {name}", result, 1_000, seed, False))
    return rows
