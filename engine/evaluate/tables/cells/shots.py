"""Pictures of marked models from views that are not the key views, attacked and read one at a time."""

from collections.abc import Iterator
from typing import Any

import numpy as np

from engine.evaluate.bench.attacks import to_8_bit
from engine.evaluate.marked_scene import MarkedScene
from engine.model import Camera, Float32, GaussianModel
from engine.pipeline.judging import VerifyConfig, judge
from engine.pipeline.rigs import make_rig
from engine.pipeline.verification import Verification, verify_images
from engine.sim.attacks import image_attack

__all__ = ["cameras_for", "read_bits", "readings_of_picture"]

_OF_VIEWS = 0x7AB1E


def cameras_for(model: GaussianModel, count: int, size: int, seed: int) -> list[Camera]:
    """Views of the kind the key views are, drawn without the key."""
    jitter = np.random.default_rng((seed, _OF_VIEWS)).random((count, 4))
    return make_rig(model, count, size, size, jitter=jitter)


def read_bits(result: Verification, scene: MarkedScene, route: str) -> dict[str, Any]:
    """Bits by our decoder and by the paper's rule (Eq 10), and the claim, from one reading."""
    claim = result.claim
    paper = judge(result.evidence, scene.opened, route, 1, VerifyConfig(decoder="paper"))
    return {
        "z": claim.z,
        "right": claim.matching_bits,
        "bits": claim.bits,
        "right_by_eq10": paper.matching_bits,
        "claimed": claim.verdict.value == "marked",
        "log10_false_claim": claim.log10_false_claim,
        "seconds": result.seconds,
    }


def readings_of_picture(
    picture: Float32,
    camera: Camera,
    scene: MarkedScene,
    attacks: dict[str, tuple[str, float, str]],
    seed: tuple[int, ...],
) -> Iterator[dict[str, Any]]:
    """One claim from each attacked version of a picture whose camera is known.

    Parameters
    ----------
    picture : (H, W, 3) float32
    attacks : dict
        Label -> attack, strength and reading; an empty name of an attack leaves the picture as it is.
    seed : tuple of int
        Of the attacks' random choices.

    Yields
    ------
    dict
        ``attack`` and the fields of `read_bits`.
    """
    stored = to_8_bit(picture)
    for number, (label, (attack, strength, reading)) in enumerate(attacks.items()):
        suspect = stored
        if attack:
            rng = np.random.default_rng((*seed, number))
            suspect = to_8_bit(image_attack(attack).apply(stored, strength, rng=rng, reading=reading))
        result = verify_images([suspect], scene.opened, cameras=[camera])
        yield {"attack": label, **read_bits(result, scene, "image")}
