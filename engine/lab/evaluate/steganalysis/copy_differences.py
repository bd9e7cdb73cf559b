"""What the differences of two copies tell of the owner's layer, which both have: nothing, if it is built well.

A classifier is trained on one half of the scene, with the owner's secrets known there, and tested on the other half;
and the other way round.

- *Signs*: each chip of the grain, by its own difference, those of its Gaussian's other chips and the means of its
  neighbors'.
- *Borders*: each Gaussian and some neighbors, in one cell of the owner's tint or in two, by how far the differences of
  their colors and shapes are apart. Borders of public cells are in every key's, so only those pairs count that one
  cell of the owner joins and a border of a key that had no part in the copies divides, or the other way round: were
  nothing shown but what is public, either key would be as likely. Pairs that are near and alike are in one cell more
  often: both kinds are weighted alike at each distance in place and color.
- *Checks*: the signs of the first copy's own values, which the difference must tell, or the classifier is blind; and
  the borders of the cells on which copies differ, which it may.
"""

from collections.abc import Iterator
from pathlib import Path

import numpy as np
from scipy.spatial import cKDTree

from engine.extras import load_extra
from engine.flows.embed.profiles import profile
from engine.lab.evaluate.marked_scene import MarkedScene, mark_copies
from engine.lab.evaluate.study import Row
from engine.lab.sim.adversaries.collusion import in_order_of
from engine.lab.sim.attacks import model_attack
from engine.model import Bool, Float64, GaussianModel, Int32, Int64
from engine.numerics.similarity import quaternion_to_rotation
from engine.watermark.grain import ATTRIBUTES, units

__all__ = ["SECRETS", "compare_copies"]

SECRETS = ("signs", "borders")
NEIGHBORS = 8
BITS = 32
CLASSES = 20, 10
"""Of distance in place and in color, within which pairs of both kinds are weighted alike."""
Case = tuple[Float64, Bool, Float64, Int64]
"""Features (M, F), labels, weights, and the Gaussian that each belongs to."""


def compare_copies(path: str, profile_name: str, form: str, pairs: int, seed: int) -> list[Row]:
    """One row for each secret: ``auc`` over so many ``cases``. `pairs` of copies are compared, each with the other."""
    names = [f"copy {number}" for number in range(2 * pairs)]
    copies = mark_copies(path, profile(profile_name, landmark_views=0), names, bits=BITS, seed=seed)
    near = cKDTree(copies[0].original.means).query(copies[0].original.means, NEIGHBORS + 1, workers=2)[1][:, 1:]
    differences = [_difference(a, b, form) for a, b in zip(copies[::2], copies[1::2], strict=True)]
    means = copies[0].original.means
    along = means[:, np.ptp(means, axis=0).argmax()]
    half = np.asarray(along < np.median(along))  # of the scene: Gaussians of one cell would tell of each other
    rows = []
    stranger = mark_copies(path, profile(profile_name, landmark_views=0), names[:1], bits=BITS, seed=seed + 1)[0]
    for secret in (*SECRETS, *(f"check: {secret}" for secret in SECRETS)):
        parts = [
            part
            for number, difference in enumerate(differences)
            for part in (
                _border_cases(copies[0], stranger, difference, near, secret)
                if secret.endswith("borders")
                else _sign_cases(copies[2 * number], difference, near, secret)
            )
        ]
        auc, cases = _crossed(parts, half, seed)
        about = {"scene": Path(path).name, "secret": secret, "form": form}
        rows.append({**about, "difference_auc": auc, "cases": cases})
    return rows


def _difference(one: MarkedScene, other: MarkedScene, form: str) -> Float64:
    """(N, 9) of centers along the own axes, in `units`, of log scales and of colors, each in its standard deviation."""
    a, b = (_delivered(each, form) for each in (one, other))
    original = one.original
    R = quaternion_to_rotation(original.quats)
    moved = np.einsum("nji,nj->ni", R, a.means.astype(np.float64) - b.means) / units(original.log_scales)
    parts = [moved, a.log_scales.astype(np.float64) - b.log_scales, a.sh[:, 0].astype(np.float64) - b.sh[:, 0]]
    values = np.concatenate(parts, axis=1)
    return np.asarray(values / (values.std(axis=0) + 1e-12))


def _delivered(scene: MarkedScene, form: str) -> GaussianModel:
    """A copy in the original's order."""
    if form == "floats":
        return scene.marked
    return in_order_of(scene.original, model_attack("convert").apply(scene.marked, form))


def _border_cases(
    scene: MarkedScene, stranger: MarkedScene, difference: Float64, near: Int64, secret: str
) -> Iterator[Case]:
    """Pairs about which two keys disagree; positive where the border is the owner's. Of the check, borders of the cells
    on which copies differ."""
    cells, others = (_cells(each, secret) for each in (scene, stranger))
    means, colors = (values.astype(np.float64) for values in (scene.original.means, scene.original.sh[:, 0]))
    for other in near.T[: NEIGHBORS - 2]:
        crossed = cells != cells[other]
        rows = np.flatnonzero(crossed != (others != others[other]))
        apart = np.abs(difference[rows] - difference[other[rows]])
        here, there = rows, other[rows]
        gaps = [np.linalg.norm(values[here] - values[there], axis=1) for values in (means, colors)]
        yield apart, crossed[rows], _balanced(gaps, crossed[rows]), rows


def _cells(scene: MarkedScene, secret: str) -> Int32:
    if secret == "borders":
        return scene.opened.layout.labels[0]
    assert scene.opened.copies is not None
    return scene.opened.copies.layout.labels[0]


def _sign_cases(scene: MarkedScene, difference: Float64, near: Int64, secret: str) -> Iterator[Case]:
    """Chips of the grain: the owner's, or the copy's own."""
    grain = difference[:, :ATTRIBUTES]
    around = grain[near].mean(axis=1)
    if secret == "signs":
        spreading = scene.opened.spreading_of(scene.opened.layout.chips + grain.size)
        values = spreading.signs(scene.opened.message)[scene.opened.layout.chips :]
    else:
        assert scene.opened.copies is not None
        values = scene.opened.copy_spreading().chips[scene.opened.copies.layout.chips :]
    positive = np.asarray(values).reshape(-1, ATTRIBUTES) > 0
    for chip in range(ATTRIBUTES):
        others = np.roll(difference, -chip, axis=1) if chip < 3 else np.roll(difference[:, ::-1], chip, axis=1)
        features = np.concatenate([grain[:, [chip]], np.abs(grain[:, [chip]]), around[:, [chip]], others], axis=1)
        yield features, positive[:, chip], np.ones(len(near)), np.arange(len(near))


def _balanced(gaps: list[Float64], crossed: Bool) -> Float64:
    """(M,) weights with which both kinds of pairs are as frequent in each class of the `gaps` (M,)."""
    group = np.zeros(len(crossed), dtype=np.int64)
    for apart, classes in zip(gaps, CLASSES, strict=True):
        group = group * classes + np.argsort(np.argsort(apart, kind="stable"), kind="stable") * classes // len(apart)
    counts = np.stack([np.bincount(group, crossed == kind, int(np.prod(CLASSES))) for kind in (False, True)])
    fewer, own = counts.min(axis=0)[group], counts[crossed.astype(int), group]
    return np.asarray(fewer / np.maximum(own, 1.0))


def _crossed(parts: list[Case], half: Bool, seed: int) -> tuple[float, int]:
    """AUC of a classifier on the half that it was not trained on, both ways; and the number of cases."""
    load_extra("sklearn", "lab", "the learned detector")
    from sklearn.ensemble import HistGradientBoostingClassifier
    from sklearn.metrics import roc_auc_score

    features, labels, weights = (np.concatenate([part[k] for part in parts]) for k in range(3))
    trained = half[np.concatenate([part[3] for part in parts])]
    score = np.empty(len(labels))
    for held_out in (trained, ~trained):
        classifier = HistGradientBoostingClassifier(max_iter=60, random_state=seed)
        classifier.fit(features[~held_out], labels[~held_out], weights[~held_out])
        score[held_out] = classifier.predict_proba(features[held_out])[:, 1]
    return float(roc_auc_score(labels, score, sample_weight=weights)), int((weights > 0).sum())
