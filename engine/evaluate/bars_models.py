"""Model attacks on a marked scene: bits, z and claim after each (`mark3dgs bench attacks`)."""

import time
from typing import Any

from engine.evaluate.marked_scene import MarkedScene
from engine.pipeline.verification import Verification, VerifyConfig, verify_model
from engine.sim.suite import Trial, apply_chain

MODEL_BARS: tuple[tuple[str, tuple[tuple[str, float | str], ...]], ...] = (
    ("none", ()),
    ("similarity x10 + shuffle", (("similarity", 10.0), ("shuffle", 1.0))),
    ("clone 50 %", (("clone", 0.5),)),
    ("prune random 20 %", (("prune_random", 0.2),)),
    ("prune random 50 %", (("prune_random", 0.5),)),
    ("prune random 90 %", (("prune_random", 0.9),)),
    ("crop to 60 %", (("crop", 0.6),)),
    ("crop to 25 %", (("crop", 0.25),)),
    ("crop to 10 %", (("crop", 0.1),)),
    ("noise 0.1 on all", (("noise_all", 0.1),)),
    (".splat and back", (("convert", "splat"),)),
    (".spz and back", (("convert", "spz"),)),
    (".sog and back", (("convert", "sog"),)),
    (".compressed.ply and back", (("convert", "compressed.ply"),)),
    ("merged into another scene", (("merge_into", 3.0),)),
    (
        "crop 25 % + similarity + shuffle + noise 0.02",
        (("crop", 0.25), ("similarity", 4.0), ("shuffle", 1.0), ("noise_all", 0.02)),
    ),
)
"""The bars on models: name and chain of attacks."""


def row(name: str, verification: Verification, seconds: float) -> dict[str, Any]:
    """One line of a table of attacks."""
    claim = verification.claim
    return {
        "attack": name,
        "bit_accuracy": claim.bit_accuracy,
        "z": claim.z,
        "log10_false_claim": claim.log10_false_claim,
        "verdict": claim.verdict.value,
        "derived_fraction": claim.derived_fraction,
        "seconds": seconds,
    }


def bench_model_attacks(scene: MarkedScene, seed: int = 0) -> list[dict[str, Any]]:
    """All model bars on one scene, default settings of the verifier."""
    rows = []
    for name, chain in MODEL_BARS:
        suspect = apply_chain(scene.marked, Trial(name, chain, "bars"), seed)
        began = time.perf_counter()
        result = verify_model(suspect, scene.opened, VerifyConfig(route="model"))
        rows.append({"scene": scene.name, **row(name, result, time.perf_counter() - began)})
    return rows
