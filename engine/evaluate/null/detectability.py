"""Do the numbers in a marked file look different? Sinkhorn distances of attribute distributions (KeySS, ICLR 2026).

The searcher has no key and no original; the strictest case gives him unmarked Gaussians of the very same scene.
"""

import numpy as np

from engine.evaluate.null.sinkhorn import permutation_test
from engine.evaluate.null.suspects import marked_scene
from engine.evaluate.study import Row
from engine.model import Float64, GaussianModel

__all__ = ["compare_attributes"]


def compare_attributes(path: str, samples: int, draws: int, keys: int, quick: bool, seed: int) -> list[Row]:
    """Disjoint random samples of one scene: unmarked against unmarked, unmarked against marked, one row for each.

    A blatant mark (DC 20 times as far displaced) stands beside: the test can see what there is to see.
    """
    rows = []
    for number in range(keys):
        scene = marked_scene(path, quick, seed + number)
        rng = np.random.default_rng((seed, number, 0x51))
        order = rng.permutation(len(scene.marked))
        here, there = order[:samples], order[samples : 2 * samples]
        shift = scene.marked.sh - scene.opened.reference.sh
        blatant = scene.marked.with_(sh=scene.opened.reference.sh + np.float32(20.0) * shift)
        for features, table in (("colour", _colors), ("all attributes", _attributes)):
            scale = table(scene.original).std(axis=0) + 1e-9
            plain = table(scene.original) / scale
            others = {
                "another unmarked sample": plain,
                "marked": table(scene.marked) / scale,
                "marked 20 times as strongly": table(blatant) / scale,
            }
            for name, other in others.items():
                distance, p, null = permutation_test(plain[here], other[there], draws=draws, seed=seed)
                rows.append(
                    {
                        "what": "detectability",
                        "scene": scene.name,
                        "key": seed + number,
                        "features": features,
                        "against": name,
                        "samples": samples,
                        "distance": distance,
                        "p": p,
                        "draws": draws,
                        "null_median": float(np.median(null)),
                        "null_highest": max(null),
                    }
                )
    return rows


def _colors(model: GaussianModel) -> Float64:
    return model.sh[:, 0].astype(np.float64)


def _attributes(model: GaussianModel) -> Float64:
    columns = [model.sh[:, 0], np.sort(model.log_scales, axis=1), model.opacity_logits[:, None]]
    return np.concatenate(columns, axis=1).astype(np.float64)
