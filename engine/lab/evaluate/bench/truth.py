"""Truth: forged originals, and innocents among colluding buyers.

Extraction is informed: every suspect is read against the owner's records.
"""

import hashlib
from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import islice, product

import numpy as np

from engine.errors import InputError
from engine.flows.embed.embedding import embed
from engine.flows.embed.layer_strengths import add_dc
from engine.flows.embed.profiles import EmbedConfig
from engine.flows.embed.profiles import profile as named_profile
from engine.flows.progress import Clock
from engine.flows.records.opened_record import OpenedRecord, open_record
from engine.flows.trace.copies import Copies
from engine.flows.trace.tracing import count_copy_tries, judge_copy
from engine.flows.verify.search import Answer, Suspect, VerifyConfig, count_tries, verify_model
from engine.flows.views.camera_rig import make_rig
from engine.lab.evaluate.bench.attacks import BITS, claim_row
from engine.lab.evaluate.marked_scene import MarkedScene, bench_key, mark_copies
from engine.lab.evaluate.study import Row
from engine.lab.sim.adversaries.collusion import RULES, in_order_of
from engine.lab.sim.adversaries.laundering import shake
from engine.lab.sim.attack import Strength
from engine.lab.sim.attacks import model_attack
from engine.model import GaussianModel
from engine.numerics.blas import one_blas_thread
from engine.numerics.image_metrics import psnr
from engine.raster import render
from engine.records.header import chip_context
from engine.watermark.keys import CHIPS, COPY, OwnerKey, signs
from engine.watermark.rates import MADE_FIRST
from engine.watermark.statistics import z_threshold

COLLUDERS = (2, 3, 5, 10)
FORMS = ("ply", "splat", "spz", "sog", "compressed.ply")  # in which the buyers get their copies
PUSHES = (5.5, 10.0, 16.0)  # steps, see the attack `push`
SHAKES = (1.0, 2.0, 4.0)  # sizes, see `shake`
VIEWS, SIDE = 4, 640  # in which a result is compared with the original
BUYER, INNOCENT = "buyer", "innocent"


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


def measure_collusion(scene: str, seed: int, innocents: int, settings: Sequence[str] = ()) -> list[Row]:
    """Copies of one scene for several buyers, put together by every rule of `collude`, perhaps shaken afterwards.

    Each result is placed and read once: for the owner's claim, and for the copies of the buyers and some of the
    `innocents`, which are dealt among the results. `psnr_db` is the least of some views against the original.
    `settings` limits the study to some of FORMS, and to some numbers of COLLUDERS; InputError where it names neither.
    """
    forms, counts = _chosen(settings)
    names = [f"{BUYER} {number}" for number in range(max(counts))]
    copies = mark_copies(scene, named_profile("fast", landmark_views=0), names, bits=BITS, seed=seed)
    opened = [copy.opened for copy in copies]
    cameras = make_rig(copies[0].original, VIEWS, SIDE, SIDE)
    truth = [render(copies[0].original, camera) for camera in cameras]
    cells = list(product(counts, _ways()))
    strangers = innocent_copies(opened[0], bench_key(seed), innocents)
    share = -(-innocents // (len(forms) * len(cells)))
    rows = []
    for form in forms:
        given = _as_delivered([copy.marked for copy in copies], form)
        for count, (way, attack, strength, sigma) in cells:
            rng = np.random.default_rng((seed, count))
            suspect = model_attack(attack).apply(given[0], strength, rng=rng, others=given[1:count])
            suspect = shake(suspect, sigma, rng) if sigma else suspect
            about = {"scene": copies[0].name, "way": way, "format": form, "colluders": count}
            about["psnr_db"] = min(psnr(a, render(suspect, camera)) for a, camera in zip(truth, cameras, strict=True))
            rows.append(about | read_copies(suspect, [*opened[:count], *islice(strangers, share)]))
    return rows


@one_blas_thread
def read_copies(suspect: GaussianModel, records: Sequence[OpenedRecord]) -> Row:
    """What `verify_model` says of the first record, and `trace_model` of all, along the route "model": one placement
    for both. A record's name says whether it is of a buyer or of an innocent."""
    config, routes = VerifyConfig(route="model"), ("model",)
    asset = Copies(Suspect(suspect), records[0], routes, config, Clock())
    asset.go_along(0)
    answer = Answer(replace(config, tries=count_tries(1, routes, config)))
    answer.hear(records[0], asset.reading)
    claim = answer.verification.claim
    least = z_threshold(config.false_claim_rate, count_copy_tries(len(records), routes, config))
    z: dict[str, list[float]] = {BUYER: [], INNOCENT: []}
    for record in records:
        z[record.copy.split()[0]].append(judge_copy(asset, record).z)
    named = {kind: sum(abs(value) >= least for value in values) for kind, values in z.items()}
    return {
        "z": claim.z,
        "verdict": claim.verdict.value,
        "named": named[BUYER],
        "z_least": min(z[BUYER]),
        "z_most": max(z[BUYER]),
        "innocents": len(z[INNOCENT]),
        "innocents_named": named[INNOCENT],
        "innocent_z_largest": max(z[INNOCENT], default=0.0),
        "z_threshold": least,
    }


def _chosen(settings: Sequence[str]) -> tuple[list[str], list[int]]:
    """Formats and numbers of colluders; all of those of which none is named."""
    numbers = {str(count): count for count in COLLUDERS}
    for name in settings:
        if name not in FORMS and name not in numbers:
            raise InputError(f"collusion has the settings {', '.join((*FORMS, *numbers))}, got {name!r}")
    forms = [form for form in FORMS if form in settings]
    return forms or list(FORMS), [numbers[name] for name in numbers if name in settings] or list(COLLUDERS)


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
