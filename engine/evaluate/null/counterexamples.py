"""What must fail, and does: a detector with the classic mistake, forged originals, and a detector that tells too much.

Without these, a test of false claims that never fails would prove nothing.
"""

import math

import numpy as np

from engine.evaluate.bench.truth import forge
from engine.evaluate.marked_scene import bench_key
from engine.evaluate.null.counting import above
from engine.evaluate.null.suspects import config_of, marked_scene
from engine.evaluate.study import Row
from engine.model import Float64
from engine.pipeline.strength import add_dc
from engine.watermark.keys import CHIPS, signs
from engine.watermark.model_evidence import gather_model_evidence
from engine.watermark.statistics import claim_z, z_threshold

__all__ = ["ask_oracle", "forge_original", "rebuild_reference"]

QUERIES = (5, 10, 20, 50, 100, 200, 500, 1_000)


def rebuild_reference(path: str, keys: int, quick: bool, seed: int) -> list[Row]:
    """Wrong keys on a detector that rebuilds the reference as "suspect minus my mark": every key finds itself."""
    scene = marked_scene(path, quick, seed)
    opened, layout = scene.opened, scene.opened.layout
    suspect = scene.marked.sh[:, 0]
    matches = np.arange(len(suspect), dtype=np.int32)
    quality = np.ones(len(suspect), dtype=np.float32)
    bit_of = np.zeros(layout.chips, dtype=np.int32)
    message = np.ones(1, dtype=np.int8)
    z = []
    for number in range(keys):
        chips = signs(bench_key(10_000 + seed + number).derive(CHIPS, b"wrong detector"), layout.chips)
        own = layout.displace(opened.strength * layout.amplitudes * chips)
        rebuilt = add_dc(scene.marked.sh, -own)[:, 0]
        evidence = gather_model_evidence(layout, rebuilt, suspect, matches, quality)
        z.append(claim_z(evidence.y, evidence.weights, bit_of, chips, message))
    return [
        {
            "what": "wrong detector",
            "scene": scene.name,
            "keys": keys,
            "hits": above(z),
            "z_least": min(z),
            "z_largest": max(z),
            "claims": int(np.sum(np.array(z) >= z_threshold(1e-9))),
        }
    ]


def forge_original(path: str, quick: bool, seed: int) -> list[Row]:
    """A thief's "original" (marked model minus a mark of his), registered and claimed by the right program."""
    return [{"what": "forged", **forge(marked_scene(path, quick, seed), config_of(quick))}]


def ask_oracle(path: str, repeats: int, quick: bool, seed: int) -> list[Row]:
    """Frame the owner by asking his detector about patterns, and adding up those it likes.

    The attacker is given the code vectors. A detector that tells z leaks its chips: the sum of patterns, each times
    its z, grows by the square root of the questions. One that says only whether the mark is there says the same of
    every pattern, and so nothing. (Who holds a marked copy can still walk along the edge of the verdict.)
    """
    opened = marked_scene(path, quick, seed).opened
    secret = (opened.spreading.chips * opened.message[opened.spreading.bit_of]).astype(np.float64)
    threshold = z_threshold(1e-9)
    rows = []
    for repeat in range(repeats):
        rng = np.random.default_rng((seed, repeat, 0x04AC1E))
        by_z, by_verdict = np.zeros(len(secret)), np.zeros(len(secret))
        asked = 0
        for count in QUERIES:
            for _ in range(count - asked):
                pattern = 2.0 * rng.integers(0, 2, len(secret), dtype=np.int8) - 1.0
                z = float(pattern @ secret) / math.sqrt(len(secret))
                by_z += z * pattern
                by_verdict += float(z >= threshold) * pattern
            asked = count
            rows.append(
                {
                    "what": "oracle",
                    "queries": count,
                    "repeat": repeat,
                    "z_told_z": _z(by_z, secret),
                    "z_told_verdict": _z(by_verdict, secret),
                    "z_threshold": threshold,
                }
            )
    return rows


def _z(evidence: Float64, secret: Float64) -> float:
    norm = float(np.linalg.norm(evidence))
    return float(evidence @ secret) / norm if norm > 0 else 0.0
