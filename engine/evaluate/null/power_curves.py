"""How much evidence a claim needs: Gaussians of a thinned model, and small, noisy pictures added up."""

import numpy as np

from engine.evaluate.bench.attacks import to_8_bit
from engine.evaluate.null.counting import above, wrong_key_seed
from engine.evaluate.null.suspects import marked_scene
from engine.evaluate.study import Row
from engine.pipeline.rigs import make_rig
from engine.pipeline.verification import VerifyConfig, verify_images, verify_model
from engine.raster import render
from engine.sim.attacks import image_attack, model_attack
from engine.watermark.image_evidence import add_evidence
from engine.watermark.power import expected_z
from engine.watermark.statistics import claim_z, wrong_key_z

__all__ = ["few_gaussians", "few_pictures"]

SIDE, NOISE = 128, 0.2
"""Pixels and noise of a picture bad enough that one of them proves nothing."""
WRONG = 20_000
"""Wrong keys for each condition of the ROC."""


def few_gaussians(path: str, shares: list[float], trials: int, quick: bool, seed: int) -> list[Row]:
    """z after all but a share of the Gaussians was removed at random; no claim is a miss here."""
    scene = marked_scene(path, quick, seed)
    rows = []
    for share in shares:
        for trial in range(trials):
            rng = np.random.default_rng((seed, trial))
            left = model_attack("prune_random").apply(scene.marked, 1.0 - share, rng=rng)
            result = verify_model(left, scene.opened, VerifyConfig(route="model", seed=trial))
            evidence, claim = result.evidence, result.claim
            rows.append(
                {
                    "what": "power",
                    "kind": "gaussians",
                    "scene": scene.name,
                    "amount": len(left),
                    "trial": trial,
                    "share": share,
                    "z": claim.z,
                    "z_expected": claim.expected_z,
                    "z_threshold": claim.z_threshold,
                    "wrong": WRONG,
                    "wrong_hits": above(
                        wrong_key_z(evidence.y, evidence.weights, wrong_key_seed(scene.name, share, trial, seed), WRONG)
                    ),
                }
            )
    return rows


def few_pictures(path: str, counts: list[int], draws: int, quick: bool, seed: int) -> list[Row]:
    """z of 1, 2, 4 ... small noisy pictures together: each is read once, and random subsets are added up."""
    scene = marked_scene(path, quick, seed)
    opened = scene.opened
    rng = np.random.default_rng((seed, 0x9017))
    most = max(counts)
    parts = []
    for number, camera in enumerate(make_rig(scene.marked, 2 * most, SIDE, SIDE, jitter=rng.random((2 * most, 4)))):
        clean = to_8_bit(render(scene.marked, camera))
        picture = to_8_bit(image_attack("noise_image").apply(clean, NOISE, rng=number))
        parts.append(verify_images([picture], opened, cameras=[camera]).evidence)
    rows = []
    for count in counts:
        for trial in range(draws):
            chosen = rng.choice(len(parts), count, replace=False)
            evidence = add_evidence([parts[k] for k in chosen])
            z = claim_z(evidence.y, evidence.weights, opened.spreading.bit_of, opened.spreading.chips, opened.message)
            row = {
                "what": "power",
                "kind": "pictures",
                "scene": scene.name,
                "amount": count,
                "trial": trial,
                "z": z,
                "z_expected": expected_z(evidence.y, evidence.weights, evidence.signal),
            }
            if trial == 0:
                stream = wrong_key_seed(scene.name, count, "pictures", seed)
                row |= {"wrong": WRONG, "wrong_hits": above(wrong_key_z(evidence.y, evidence.weights, stream, WRONG))}
            rows.append(row)
    return rows
