"""What is tried: suspects that no key without a part in them may claim, counterexamples, and thin evidence.

Suspects are marked by others, unmarked, or made to deceive. Without the counterexamples (a detector that
breaks the bound, forged originals) a test of false claims that never fails would prove nothing.
"""

from collections.abc import Callable, Iterator, Sequence
from functools import reduce
from pathlib import Path

import numpy as np

from engine.flows.embed.embedding import embed
from engine.flows.embed.layer_strengths import add_dc
from engine.flows.records.opened_record import open_record
from engine.flows.verify.decision import read_copy
from engine.flows.verify.search import Verification, VerifyConfig, verify_images, verify_model
from engine.flows.views.camera_rig import make_rig
from engine.formats import read_model
from engine.lab.evaluate.bench.attacks import to_8_bit
from engine.lab.evaluate.bench.truth import forge, innocent_copies
from engine.lab.evaluate.marked_scene import MarkedScene, bench_key
from engine.lab.evaluate.marked_subjects import fast_config, fast_mark, picture_of
from engine.lab.evaluate.null.null_rates import above, count_wrong_keys, counted
from engine.lab.evaluate.study import Row
from engine.lab.sim.attacks import image_attack, model_attack
from engine.model import Float64, GaussianModel
from engine.registration.mixtures import Mixtures
from engine.watermark.keys import CHIPS, signs
from engine.watermark.model_evidence import Evidence, compare_colors, gather_residual
from engine.watermark.power import expected_z
from engine.watermark.rates import MADE_FIRST
from engine.watermark.statistics import claim_z, z_threshold

__all__ = [
    "FOUND",
    "few_gaussians",
    "few_pictures",
    "forge_original",
    "rebuild_reference",
    "try_copies",
    "try_crafted",
    "try_found",
    "try_pairs",
]

FOUND = {
    "marked": "marked by the owner",
    "noised": "marked, noise 0.1",
    "unmarked": "unmarked",
    "foreign": "marked by another key",
}
LOUD = 40
"""Code vectors that drown all others in one of the crafted suspects."""

SIDE, NOISE = 128, 0.2
"""Pixels and noise of a picture bad enough that one of them proves nothing."""
WRONG = 20_000
"""Wrong keys for each condition of the ROC."""


def _row(group: str, scene: str, suspect: str, route: str, carries: bool, z: float, verdict: str, keys: Row) -> Row:
    """One suspect: what the record itself answered, and how far wrong keys came on the same evidence."""
    about = {"what": "null", "group": group, "scene": scene, "suspect": suspect, "route": route, "carries": carries}
    return {**about, "z_own": z, "verdict": verdict, **keys}


def _tried(group: str, scene: MarkedScene, name: str, result: Verification, keys: int, seed: int, own: bool) -> Row:
    y, weights, claim = result.evidence.y, result.evidence.weights, result.claim
    wrong = count_wrong_keys(y, weights, keys, scene.name, name, claim.route, seed)
    return _row(group, scene.name, name, claim.route, own, claim.z, claim.verdict.value, wrong)


def _routes(scene: MarkedScene, suspect: GaussianModel, routes: Sequence[str]) -> Iterator[Verification]:
    for route in routes:
        if route != "image":
            yield verify_model(suspect, scene.opened, VerifyConfig(route=route))
            continue
        camera = scene.opened.cameras[0]
        yield verify_images([picture_of(suspect, camera)], scene.opened, cameras=[camera])


def try_found(path: str, name: str, keys: int, quick: bool, seed: int) -> list[Row]:
    """Wrong keys on all evidence of a model that turned up, one of `FOUND`.

    A quick run looks at the Gaussians alone; of the marked model at one picture, too.
    """
    scene = fast_mark(path, quick, seed)
    if name == "foreign":
        suspect = fast_mark(path, quick, seed + 1).marked
    elif name == "noised":
        suspect = model_attack("noise_all").apply(scene.marked, 0.1, rng=seed)
    else:
        suspect = {"marked": scene.marked, "unmarked": scene.original}[name]
    routes = ["model", "render", "image"]
    if quick:
        routes = ["model", "image"] if name == "marked" else ["model"]
    return [
        _tried("found", scene, FOUND[name], result, keys, seed, name in ("marked", "noised"))
        for result in _routes(scene, suspect, routes)
    ]


def try_crafted(path: str, keys: int, quick: bool, seed: int) -> list[Row]:
    """Suspects made to deceive the detector by someone who knows the reference and its code vectors, but no chip."""
    scene = fast_mark(path, quick, seed)
    opened, layout = scene.opened, scene.opened.layout
    reference, amplitudes = opened.reference, opened.strength * layout.amplitudes
    rng = np.random.default_rng((seed, 0xADE))
    read = verify_model(scene.marked, opened, VerifyConfig(route="model")).evidence

    def loud(count: int, factor: float) -> Float64:
        chosen = np.zeros(layout.chips)
        at = rng.choice(layout.chips, count, replace=False)
        chosen[at] = factor * amplitudes[at] * rng.choice([-1.0, 1.0], count)
        return chosen

    displaced: dict[str, Callable[[], Float64]] = {
        "every chip at its full strength, guessed signs": lambda: amplitudes * rng.choice([-1.0, 1.0], layout.chips),
        "every chip pushed the same way": lambda: amplitudes,
        "normal noise along the carriers": lambda: amplitudes * rng.standard_normal(layout.chips),
        "heavy-tailed noise along the carriers": lambda: amplitudes * rng.standard_cauchy(layout.chips).clip(-300, 300),
        f"{LOUD} code vectors drown the others": lambda: loud(LOUD, 100.0),
        "one code vector drowns the others": lambda: loud(1, 1000.0),
    }
    # Owner's mark, every chip made equally loud: still his, so only wrong keys are counted.
    owners = "owner's evidence sharpened"
    suspects = {name: add_dc(reference.sh, layout.displace(make())) for name, make in displaced.items()}
    suspects["one Gaussian dominates"] = reference.sh.copy()
    suspects["one Gaussian dominates"][len(reference) // 2, 0] += 50.0
    suspects[owners] = add_dc(reference.sh, layout.displace(np.sign(read.y) * np.median(np.abs(read.y))))
    rows = []
    for name, sh in suspects.items():
        result = verify_model(reference.with_(sh=sh), opened, VerifyConfig(route="model"))
        rows.append(_tried("crafted", scene, name, result, keys, seed, name == owners))
    return rows


def try_copies(path: str, copies: int, quick: bool, seed: int) -> list[Row]:
    """Records of innocent recipients, drawn by the real key derivation, tested on one recipient's copy."""
    loaded, key = read_model(path), bench_key(seed)
    made = embed(loaded.model, key, original_sha256=loaded.sha256, bits=32, config=fast_config(quick), copy="guilty")
    opened = open_record(made.record.to_bytes(key), key, MADE_FIRST)
    result = verify_model(made.model, opened, VerifyConfig(route="model"))
    assert result.reading is not None
    read = (read_copy(result.reading, each) for each in innocent_copies(opened, key, copies))
    z = np.array([each.z for each in read if each is not None])
    verdict = "marked" if result.claim.z_threshold <= z.max() else "not_marked"
    what = "copies of other recipients"
    return [_row("copies", Path(path).name, what, "model", False, float(z.max()), verdict, counted(z))]


def try_pairs(path: str, other: str, quick: bool, seed: int) -> list[Row]:
    """This scene's record against another scene: unmarked, marked, and with this scene's mark lifted onto it."""
    scene, foreign = fast_mark(path, quick, seed), fast_mark(other, quick, seed + 1)
    lifted = model_attack("transplant").apply(foreign.original, 1.0, rng=seed, source=scene.marked)
    suspects = {"unmarked": foreign.original, "marked": foreign.marked, "with this mark lifted onto it": lifted}
    rows = []
    for name, suspect in suspects.items():
        result = verify_model(suspect, scene.opened, VerifyConfig(route="model"))
        rows.append(_tried("other scene", scene, f"{foreign.name} {name}", result, 1_000, seed, False))
    return rows


def rebuild_reference(path: str, keys: int, quick: bool, seed: int) -> list[Row]:
    """Wrong keys on a detector that rebuilds the reference as "suspect minus my mark": every key finds itself."""
    scene = fast_mark(path, quick, seed)
    opened, layout = scene.opened, scene.opened.layout
    suspect = scene.marked.sh[:, 0]
    itself = Mixtures.of_matches(np.arange(len(suspect), dtype=np.int32), np.ones(len(suspect), dtype=np.float32))
    bit_of, message = np.zeros(layout.chips, dtype=np.int32), np.ones(1, dtype=np.int8)
    z = []
    for number in range(keys):
        chips = signs(bench_key(10_000 + seed + number).derive(CHIPS, b"wrong detector"), layout.chips)
        own = layout.displace(opened.strength * layout.amplitudes * chips)
        rebuilt = add_dc(scene.marked.sh, -own)[:, 0]
        evidence = gather_residual(layout, compare_colors(rebuilt, suspect, itself))
        z.append(claim_z(evidence.y, evidence.weights, bit_of, chips, message))
    row = {"what": "wrong detector", "scene": scene.name, "keys": keys, "hits": above(z)}
    claims = int(np.sum(np.array(z) >= z_threshold(1e-9)))
    return [{**row, "z_least": min(z), "z_largest": max(z), "claims": claims}]


def forge_original(path: str, quick: bool, seed: int) -> list[Row]:
    """A thief's "original" (marked model minus a mark of his), registered and claimed by the right program."""
    return [{"what": "forged", **forge(fast_mark(path, quick, seed), fast_config(quick))}]


def _wrong(y: Float64, weights: Float64, *stream: object) -> Row:
    return {"wrong": WRONG, "wrong_hits": count_wrong_keys(y, weights, WRONG, *stream)["hits"]}


def few_gaussians(path: str, shares: list[float], trials: int, quick: bool, seed: int) -> list[Row]:
    """z after all but a share of the Gaussians was removed at random; no claim is a miss here."""
    scene = fast_mark(path, quick, seed)
    rows = []
    for share in shares:
        for trial in range(trials):
            rng = np.random.default_rng((seed, trial))
            left = model_attack("prune_random").apply(scene.marked, 1.0 - share, rng=rng)
            result = verify_model(left, scene.opened, VerifyConfig(route="model", seed=trial))
            evidence, claim = result.evidence, result.claim
            row = {"what": "power", "kind": "gaussians", "scene": scene.name, "amount": len(left), "trial": trial}
            row |= {"share": share, "z": claim.z, "z_expected": claim.expected_z, "z_threshold": claim.z_threshold}
            rows.append(row | _wrong(evidence.y, evidence.weights, scene.name, share, trial, seed))
    return rows


def few_pictures(path: str, counts: list[int], draws: int, quick: bool, seed: int) -> list[Row]:
    """z of 1, 2, 4 ... small noisy pictures together: each is read once, and random subsets are added up."""
    scene = fast_mark(path, quick, seed)
    opened = scene.opened
    rng = np.random.default_rng((seed, 0x9017))
    most = 2 * max(counts)
    parts = []
    for number, camera in enumerate(make_rig(scene.marked, most, SIDE, SIDE, jitter=rng.random((most, 4)))):
        picture = to_8_bit(image_attack("noise_image").apply(picture_of(scene.marked, camera), NOISE, rng=number))
        parts.append(verify_images([picture], opened, cameras=[camera]).evidence)
    rows = []
    for count in counts:
        for trial in range(draws):
            evidence = reduce(Evidence.plus, [parts[k] for k in rng.choice(len(parts), count, replace=False)])
            y, weights, spreading = evidence.y, evidence.weights, opened.spreading_of(len(evidence.y))
            row = {"what": "power", "kind": "pictures", "scene": scene.name, "amount": count, "trial": trial}
            row["z"] = claim_z(y, weights, spreading.bit_of, spreading.chips, opened.message)
            row["z_expected"] = expected_z(y, weights, evidence.signal)
            if trial == 0:
                row |= _wrong(y, weights, scene.name, count, "pictures", seed)
            rows.append(row)
    return rows
