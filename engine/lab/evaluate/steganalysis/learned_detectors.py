"""Cells with a learned detector: can a classifier without the key tell marked models from unmarked ones?

It sees what a stranger can measure on the colours of a model, region by region. A mark moves DC colours by little, but
in patches and along few directions; and it may break the lattice of values that a file format left. The features see
both: how a Gaussian's colour stands to its neighbours' at three sizes, how values are distributed, and how often
exactly the same value occurs.

The attacker is an insider, as strong as one can be without the very original: of this scene itself he has the unmarked
and several marked copies under other keys, but not the regions that he is tested on.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial import cKDTree

from engine.extras import load_extra
from engine.flows.embed.embedding import embed
from engine.flows.embed.profiles import profile
from engine.formats import read_model
from engine.lab.evaluate.intervals import area, area_interval
from engine.lab.evaluate.marked_scene import bench_key
from engine.lab.evaluate.study import Row
from engine.lab.sim.attacks import model_attack
from engine.model import SH_C0, Float64, GaussianModel, Int64
from engine.watermark.keys import OwnerKey
from engine.watermark.lattice import Even, find_lattices

__all__ = ["FORMS", "Regions", "detect_as_insider", "divide", "float_born", "measure_regions"]

BITS = 32
FORMS = ("floats", "own format")
"""How the model reaches the detector. `floats`: trained, marked and delivered in floating point. `own format`: a file
of few values, marked, delivered in that format again."""
REGION = 512
"""About so many Gaussians a region."""
NEAR, FAR = 8, 48
"""Neighbours: the nearest, and about as many as share a code vector of the coarsest stage."""
OFTEN = 4
"""Occurrences of a value that floating point does not give by chance."""
LONGEST_TAIL = 0.5
"""Mean of what was clipped beyond an end of a format's range, DC units: a seventh of black to white."""
EDGES = np.array([-2.0, -1.0, -0.5, 0.0, 0.5, 1.0, 2.0])
OPPONENT = np.array([[1.0, 1.0, 1.0], [1.0, -1.0, 0.0], [0.5, 0.5, -1.0]]) / np.sqrt([[3.0], [2.0], [1.5]])
"""Lightness and two colour differences."""


def detect_as_insider(path: str, profile_name: str, form: str, keys: int, seed: int) -> list[Row]:
    """Trained on one half of a scene's regions under `keys` keys, tested on the other half under others; both ways.

    One row a classifier: ``auc``, ``low``, ``high``, ``shift``, ``regions``.
    """
    features = _copies(path, profile_name, form, 2 * keys, seed)  # (1 + 2 keys, R, F)
    regions = features.shape[1]
    half = np.random.default_rng((seed, 3)).permutation(regions) < regions // 2
    rows = []
    for name, classifier in _classifiers(seed).items():
        score = np.empty(features.shape[:2])
        for held_out in (half, ~half):
            _fit(classifier, features[: 1 + keys, ~held_out])
            score[:, held_out] = [_score(classifier, copy[held_out]) for copy in features]
        tested = np.concatenate([score[:1], score[1 + keys :]])
        rows.append({"scene": Path(path).name, "form": form, "classifier": name, **_judged(tested)})
    return rows


def _copies(path: str, profile_name: str, form: str, keys: int, seed: int) -> Float64:
    """(1 + keys, R, F) features of the unmarked model and of copies under different keys."""
    loaded, config = read_model(path), profile(profile_name, landmark_views=0)
    base = float_born(loaded.model, np.random.default_rng((seed, 4))) if form == "floats" else loaded.model
    regions = divide(base)

    def marked(key: OwnerKey) -> GaussianModel:
        return embed(base, key, original_sha256=loaded.sha256, bits=BITS, config=config).model

    def features(model: GaussianModel) -> Float64:
        if form == "own format":
            model = _in_order(model_attack("convert").apply(model, loaded.format), model)
        return measure_regions(model, regions)

    copies = (marked(bench_key(1_000 * (seed + 1) + number)) for number in range(keys))
    return np.stack([features(base), *(features(copy) for copy in copies)])


def _in_order(stored: GaussianModel, model: GaussianModel) -> GaussianModel:
    """A format may order the Gaussians anew: back to the order that the regions know, by place and size."""

    def place(of: GaussianModel) -> Float64:
        return np.concatenate([of.means, 1e-3 * of.log_scales], axis=1).astype(np.float64)

    return stored.take(cKDTree(place(stored)).query(place(model), workers=2)[1])


def _classifiers(seed: int) -> Mapping[str, Any]:
    load_extra("sklearn", "lab", "the learned detector")
    from sklearn.ensemble import RandomForestClassifier
    from sklearn.linear_model import LogisticRegression
    from sklearn.pipeline import make_pipeline
    from sklearn.preprocessing import StandardScaler

    return {
        "logistic regression": make_pipeline(
            StandardScaler(), LogisticRegression(C=0.1, max_iter=2_000, class_weight="balanced")
        ),
        "random forest": RandomForestClassifier(
            200, min_samples_leaf=4, class_weight="balanced", random_state=seed, n_jobs=2
        ),
    }


def _fit(classifier: Any, features: Float64) -> None:
    """Anew, on features (1 + keys, R, F), the unmarked model first."""
    unmarked, marked = features[0], features[1:].reshape(-1, features.shape[2])
    classifier.fit(np.concatenate([unmarked, marked]), np.repeat([0, 1], [len(unmarked), len(marked)]))


def _score(classifier: Any, features: Float64) -> Float64:
    return np.asarray(classifier.predict_proba(features)[:, 1])


def _judged(score: Float64) -> dict[str, float]:
    """AUC of regions by their scores (1 + keys, R), the unmarked model first, resampled by region.

    ``shift`` is the mean difference of marked and unmarked scores in standard deviations of the unmarked ones: what
    averaging over many regions could add up.
    """
    places = [(score[:1, r], score[1:, r]) for r in range(score.shape[1])]
    negative = np.concatenate([a for a, _ in places])
    positive = np.concatenate([b for _, b in places])
    low, high = area_interval(places)
    spread = max(float(negative.std()), 1e-12)
    return {
        "auc": area(negative, positive),
        "low": low,
        "high": high,
        "regions": len(places),
        "marked_scores": len(positive),
        "shift": float((positive.mean() - negative.mean()) / spread),
    }


@dataclass(frozen=True, eq=False)
class Regions:
    """Compact pieces of one geometry and who is whose neighbour; the same for all copies of a scene."""

    label: Int64  # (N,) region of each Gaussian
    count: int
    neighbors: Int64  # (N, FAR) nearest first


def divide(model: GaussianModel) -> Regions:
    """Halve the longest side at its median until pieces have about 512 Gaussians."""
    means = model.means.astype(np.float64)
    pieces = [np.arange(len(model))]
    while len(pieces[0]) > 1.5 * REGION:
        halves = []
        for piece in pieces:
            axis = int(np.argmax(np.ptp(means[piece], axis=0)))
            order = piece[np.argsort(means[piece, axis], kind="stable")]
            halves += [order[: len(order) // 2], order[len(order) // 2 :]]
        pieces = halves
    label = np.empty(len(model), dtype=np.int64)
    for number, piece in enumerate(pieces):
        label[piece] = number
    neighbors = cKDTree(means).query(means, FAR + 1, workers=2)[1][:, 1:]
    return Regions(label, len(pieces), neighbors.astype(np.int64))


def measure_regions(model: GaussianModel, regions: Regions) -> Float64:
    """(regions.count, F) features of each region; the model is in the order that the regions were made of."""
    dc = model.sh[:, 0].astype(np.float64)
    colors = dc @ OPPONENT.T  # (N, 3)
    nearest = colors[regions.neighbors[:, 0]]
    near, far = (colors[regions.neighbors[:, :count]].mean(axis=1) for count in (NEAR, FAR))
    shapes = [_shape(values, regions) for values in (colors - nearest, colors - near, near - far, colors)]
    return np.concatenate([*shapes, _lattice(dc, regions)], axis=1)


def float_born(model: GaussianModel, rng: np.random.Generator) -> GaussianModel:
    """The model with DC colours spread over the cells of their lattice, as before a format rounded and clipped them.

    Scenes that can be had went through a format with few values; this is what their training had before it. Inner
    values lie anywhere in their cell. An outermost value also stands for all that was clipped there (training bounds
    no colour from above): where it holds more than its neighbour, it spreads in an exponential tail that begins with
    the neighbour's density. Steps that change from chunk to chunk are each Gaussian's own, and clip nothing.
    """
    dc = model.sh[:, 0].astype(np.float64)
    for c, lattice in enumerate(find_lattices(model).columns.get("dc", (None,) * 3)):
        if isinstance(lattice, Even) and lattice.spacing.ndim:
            dc[:, c] += rng.uniform(-0.5, 0.5, len(dc)) * lattice.spacing
            continue
        values, place, count = np.unique(dc[:, c], return_inverse=True, return_counts=True)
        if len(values) < 2:
            continue
        middle = 0.5 * (values[1:] + values[:-1])
        low = np.concatenate([2 * values[:1] - middle[:1], middle])
        high = np.concatenate([middle, 2 * values[-1:] - middle[-1:]])
        spread = rng.uniform(low[place], high[place])
        for end, neighbor, wall, away in ((0, 1, high[0], -1.0), (-1, -2, low[-1], 1.0)):
            if count[end] > count[neighbor]:
                clipped = place == np.arange(len(values))[end]
                scale = count[end] / count[neighbor] * (high[neighbor] - low[neighbor])
                tail = rng.exponential(min(scale, LONGEST_TAIL), int(clipped.sum()))
                spread[clipped] = wall + away * tail
        dc[:, c] = spread
    return model.with_dc(dc.astype(np.float32))


def _shape(values: Float64, regions: Regions) -> Float64:
    """(count, 33) spread, tails, lean, channels' correlations and histogram of (N, 3) values."""
    spread = np.sqrt(_mean(values**2, regions)) + 1e-9  # (R, 3)
    scaled = values / spread[regions.label]
    bins = np.digitize(scaled, EDGES)  # (N, 3)
    inner = np.arange(1, len(EDGES))
    columns = [
        np.log(spread),
        np.log(_mean(np.abs(scaled), regions) + 1e-9),
        _mean(scaled**3, regions).clip(-20, 20),
        np.log(_mean(scaled**4, regions) + 1e-9),
        _mean(scaled * np.roll(scaled, 1, axis=1), regions),
        *(_mean((bins[:, c : c + 1] == inner).astype(np.float64), regions) for c in range(3)),
    ]
    return np.concatenate(columns, axis=1)


def _lattice(dc: Float64, regions: Regions) -> Float64:
    """(count, 6) how often a value is shared with other Gaussians, and how far off 8-bit levels it lies."""
    columns = []
    for values in dc.T:
        _, place, count = np.unique(values, return_inverse=True, return_counts=True)
        levels = 255.0 * (0.5 + SH_C0 * values)
        columns += [count[place] >= OFTEN, np.abs(levels - np.round(levels))]
    return _mean(np.stack(columns, axis=1), regions)


def _mean(values: Float64, regions: Regions) -> Float64:
    """(count, k) mean of (N, k) values over each region."""
    total = np.bincount(regions.label, minlength=regions.count).astype(np.float64)
    sums = [np.bincount(regions.label, column, regions.count) for column in values.T]
    return np.stack(sums, axis=1) / np.maximum(total, 1.0)[:, None]
