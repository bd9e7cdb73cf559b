"""Truth: wrong keys, unmarked and foreign models, forged originals (`mark3dgs bench truth`)."""

import hashlib
from collections.abc import Sequence
from typing import Any

import numpy as np

from engine.evaluate.bars_images import random_view, to_8_bit
from engine.evaluate.bars_models import row
from engine.evaluate.marked_scene import MarkedScene, bench_key
from engine.model import GaussianModel
from engine.pipeline.embedding import embed
from engine.pipeline.profiles import EmbedConfig
from engine.pipeline.sealing import open_record
from engine.pipeline.strength import add_dc
from engine.pipeline.verification import VerifyConfig, verify_images, verify_model
from engine.raster import render
from engine.watermark.keys import CHIPS, signs
from engine.watermark.statistics import log10_false_claim_bound, wrong_key_z

THRESHOLDS = (1e-1, 1e-2, 1e-3, 1e-4, 1e-5)


def wrong_key_rates(scene: MarkedScene, count: int, seed: int = 0) -> list[dict[str, Any]]:
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


def cross_check(scenes: Sequence[MarkedScene], unmarked: Sequence[tuple[str, GaussianModel]]) -> list[dict[str, Any]]:
    """Every record against every unmarked model and every foreign-marked one, by model and by screenshot."""
    rows = []
    for scene in scenes:
        suspects = [("unmarked " + name, model) for name, model in unmarked]
        suspects += [("foreign mark " + other.name, other.marked) for other in scenes if other is not scene]
        for name, model in suspects:
            result = verify_model(model, scene.opened, VerifyConfig())
            rows.append({"record": scene.name, "route": "model", **row(name, result, result.seconds)})
            camera = random_view(model, np.random.default_rng(0), 800, 600)
            result = verify_images([to_8_bit(render(model, camera))], scene.opened)
            rows.append({"record": scene.name, "route": "image", **row(name, result, result.seconds)})
    return rows


def forge(scene: MarkedScene, config: EmbedConfig) -> dict[str, Any]:
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
    opened = open_record(result.record.to_bytes(thief), thief)
    verification = verify_model(scene.marked, opened, VerifyConfig(route="model"))
    return {"scene": scene.name, **row("forged original", verification, verification.seconds)}
