"""Truth: wrong keys, unmarked and foreign models, forged originals, and innocents among colluding buyers.

Extraction is informed: every suspect is read against the owner's records.
"""

import hashlib
from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import islice, product
from typing import Any

import numpy as np

from engine.flows.embed.embedding import embed
from engine.flows.embed.layer_strengths import add_dc
from engine.flows.embed.profiles import EmbedConfig
from engine.flows.embed.profiles import profile as named_profile
from engine.flows.records.opened_record import OpenedRecord, open_record
from engine.flows.trace.tracing import trace_model
from engine.flows.verify.search import VerifyConfig, verify_images, verify_model
from engine.flows.views.camera_rig import make_rig
from engine.lab.evaluate.bench.attacks import BITS, claim_row, random_view, to_8_bit
from engine.lab.evaluate.marked_scene import MarkedScene, bench_key, mark_copies, mark_scene
from engine.lab.evaluate.null.null_rates import wrong_key_z
from engine.lab.evaluate.study import Row
from engine.lab.sim.adversaries.collusion import RULES, in_order_of
from engine.lab.sim.adversaries.laundering import shake
from engine.lab.sim.attack import Strength
from engine.lab.sim.attacks import model_attack
from engine.model import GaussianModel
from engine.numerics.image_metrics import psnr
from engine.raster import render
from engine.records.header import chip_context
from engine.watermark.keys import CHIPS, COPY, OwnerKey, signs
from engine.watermark.rates import MADE_FIRST
from engine.watermark.statistics import log10_false_claim_bound

THRESHOLDS = (1e-1, 1e-2, 1e-3, 1e-4, 1e-5)
COLLUDERS = (2, 3, 5, 10)
FORMS = ("ply", "splat", "spz", "sog", "compressed.ply")  # in which the buyers get their copies
PUSHES = (5.5, 10.0, 16.0)  # steps, see the attack `push`
SHAKES = (1.0, 2.0, 4.0)  # sizes, see `shake`
VIEWS, SIDE = 4, 640  # in which a result is compared with the original
BUYER, INNOCENT = "buyer", "innocent"


def measure_truth(scenes: Sequence[str], seed: int, profile: str, keys: int) -> list[Row]:
    """Wrong keys on every scene, every record against every other scene, and a forged original for each."""
    marked = [mark_scene(path, named_profile(profile), seed=seed) for path in scenes]
    found = {
        "wrong keys": [row for scene in marked for row in wrong_key_rates(scene, keys, seed)],
        "cross check": _cross_check(marked),
        "forged original": [forge(scene, named_profile(profile)) for scene in marked],
    }
    return [{"check": kind, **row} for kind, rows in found.items() for row in rows]


def wrong_key_rates(scene: MarkedScene, count: int, seed: int = 0) -> list[Row]:
    """Random chips against the true reference, on evidence of the model and of one picture.

    The suspect carries a real mark, the reference is the real one; only the chips are another key's. `measured` is
    the share of keys whose own stated bound is at or below each threshold.
    """
    rng = np.random.default_rng(seed)
    camera = scene.opened.cameras[0]
    picture = to_8_bit(render(scene.marked, camera))
    evidences = {
        "model": verify_model(scene.marked, scene.opened, VerifyConfig(route="model")).evidence,
        "image": verify_images([picture], scene.opened, cameras=[camera]).evidence,
    }
    rows = []
    for route, evidence in evidences.items():
        z = wrong_key_z(evidence.y, evidence.weights, rng.bytes(32), count)
        bounds = np.array([log10_false_claim_bound(float(value)) for value in z])
        rows.append(
            {
                "scene": scene.name,
                "route": route,
                "keys": count,
                "largest_z": float(z.max()),
                "claims_at_1e-9": int((bounds <= -9).sum()),
                "measured": {f"{t:g}": float((bounds <= np.log10(t)).mean()) for t in THRESHOLDS},
            }
        )
    return rows


def _cross_check(scenes: Sequence[MarkedScene]) -> list[Row]:
    """Every record against every unmarked model and every foreign-marked one, by model and by screenshot."""
    rows = []
    for scene in scenes:
        suspects = [("unmarked " + other.name, other.original) for other in scenes]
        suspects += [("foreign mark " + other.name, other.marked) for other in scenes if other is not scene]
        for name, model in suspects:
            result = verify_model(model, scene.opened, VerifyConfig())
            rows.append({"record": scene.name, "route": "model", **claim_row(name, result)})
            camera = random_view(model, np.random.default_rng(0), 800, 600)
            result = verify_images([to_8_bit(render(model, camera))], scene.opened)
            rows.append({"record": scene.name, "route": "image", **claim_row(name, result)})
    return rows


def forge(scene: MarkedScene, config: EmbedConfig) -> Row:
    """A thief registers "marked model minus a mark of mine" as his original and claims the marked model.

    His mark is drawn as ours are, of the same strength; the record is made by the same program under his key. With
    chips bound to the digest of the original, the mark he subtracted is not the mark his record then calls for.
    """
    thief = bench_key(666)
    layout = scene.opened.layout
    chips = signs(thief.derive(CHIPS, b"forged"), layout.chips)
    own = layout.displace(scene.opened.strength * layout.amplitudes * chips)
    original = scene.marked.with_(sh=add_dc(scene.marked.sh, -own))
    digest = hashlib.sha256(original.sh.tobytes()).hexdigest()
    result = embed(original, thief, original_sha256=digest, config=config)
    opened = open_record(result.record.to_bytes(thief), thief, MADE_FIRST)
    verification = verify_model(scene.marked, opened, VerifyConfig(route="model"))
    return {"scene": scene.name, **claim_row("forged original", verification)}


def measure_collusion(scene: str, seed: int, innocents: int) -> list[Row]:
    """Copies of one scene for several buyers, put together by every rule of `collude`, perhaps shaken afterwards.

    Each result is read for the owner's claim and traced among the buyers and some of the `innocents`, which are dealt
    among the results. `psnr_db` is the least of some views against the original.
    """
    names = [f"{BUYER} {number}" for number in range(max(COLLUDERS))]
    copies = mark_copies(scene, named_profile("fast", landmark_views=0), names, bits=BITS, seed=seed)
    opened = [copy.opened for copy in copies]
    cameras = make_rig(copies[0].original, VIEWS, SIDE, SIDE)
    truth = [render(copies[0].original, camera) for camera in cameras]
    cells = list(product(FORMS, COLLUDERS, _ways()))
    strangers = innocent_copies(opened[0], bench_key(seed), innocents)
    share = -(-innocents // len(cells))
    rows = []
    for form, count, (way, attack, strength, sigma) in cells:
        rng = np.random.default_rng((seed, count))
        given = _as_delivered([copy.marked for copy in copies[:count]], form)
        suspect = model_attack(attack).apply(given[0], strength, rng=rng, others=given[1:])
        suspect = shake(suspect, sigma, rng) if sigma else suspect
        claim = verify_model(suspect, opened[0], VerifyConfig(route="model")).claim
        records = [*opened[:count], *islice(strangers, share)]
        traced = trace_model(suspect, records, VerifyConfig(route="model"))
        guilty, others = (
            [finding for finding in traced.findings if finding.copy.startswith(kind)] for kind in (BUYER, INNOCENT)
        )
        row: dict[str, Any] = {
            "scene": copies[0].name,
            "way": way,
            "format": form,
            "colluders": count,
            "psnr_db": min(psnr(a, render(suspect, camera)) for a, camera in zip(truth, cameras, strict=True)),
            "z": claim.z,
            "verdict": claim.verdict.value,
            "named": sum(finding.named for finding in guilty),
            "z_least": min(finding.z for finding in guilty),
            "z_most": max(finding.z for finding in guilty),
            "innocents": len(others),
            "innocents_named": sum(finding.named for finding in others),
            "innocent_z_largest": max((finding.z for finding in others), default=0.0),
            "z_threshold": traced.z_threshold,
        }
        rows.append(row)
    return rows


def _ways() -> Iterator[tuple[str, str, Strength, float]]:
    """Name; attack that takes the other copies, and its strength; how far centers are shaken then, in sizes."""
    for rule in RULES:
        yield rule, "collude", rule, 0.0
    yield "algebra", "algebra", "mean", 0.0
    for steps in PUSHES:
        yield f"push {steps:g}", "push", steps, 0.0
    for sigma in SHAKES:
        yield f"mean, shaken by {sigma:g}", "collude", "mean", sigma


def _as_delivered(copies: Sequence[GaussianModel], form: str) -> list[GaussianModel]:
    """Copies as buyers get them in a format, in the order of the first."""
    convert = model_attack("convert")
    given = list(copies) if form == "ply" else [convert.apply(copy, form) for copy in copies]
    return [given[0], *(in_order_of(given[0], other) for other in given[1:])]


def innocent_copies(record: OpenedRecord, key: OwnerKey, count: int) -> Iterator[OpenedRecord]:
    """Records of copies of the same asset that no suspect was made of, drawn as an embedding draws them.

    They share the owner's layer, as all copies do; the key of their own is another one's.
    """
    reference = bytes.fromhex(record.header.reference_digest)
    for number in range(count):
        name = f"{INNOCENT} {number}"
        digest = hashlib.sha256(name.encode()).digest()[:16]
        header = replace(record.header, record_id=digest.hex())
        copy_key = key.derive(COPY, chip_context(reference, digest))
        yield replace(record, header=header, copy=name, copy_key=copy_key)
