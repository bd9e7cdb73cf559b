"""Cells with a learned detector: can a classifier without the key tell marked models from unmarked ones?

Two attackers. The *stranger* has marked and unmarked models of other scenes. The *insider* is as strong as one can be
without the very original: of this scene itself he has the unmarked and several marked copies under other keys, but not
the regions he is asked about.
"""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial import cKDTree

from engine.errors import InputError
from engine.evaluate.baselines.methods import find_method
from engine.evaluate.intervals import area, area_interval
from engine.evaluate.marked_scene import bench_key
from engine.evaluate.steganalysis.attributes import divide, float_born, measure_regions
from engine.evaluate.study import Row
from engine.formats import read_model
from engine.model import Float64, GaussianModel
from engine.pipeline.embedding import embed
from engine.pipeline.profiles import profile
from engine.pipeline.rigs import make_rig
from engine.sim.attacks import model_attack
from engine.watermark.keys import OwnerKey
from engine.watermark.messages import derive_message

__all__ = ["FORMS", "detect_as_insider", "detect_as_stranger"]

BITS = 32
FORMS = ("floats", "own format", "lattice lost")
"""How the model reaches the detector. `floats`: trained, marked and delivered in floating point. `own format`: a file
of few values, marked, delivered in that format again. `lattice lost`: such a file, marked, delivered in floats."""


def detect_as_insider(path: str, profile_name: str, form: str, keys: int, seed: int, method: str = "ours") -> list[Row]:
    """Trained on one half of a scene's regions under some keys, asked about the other half under others; both ways.

    Parameters
    ----------
    form : str
        One of `FORMS`.
    keys : int
        To train on; as many others to be asked about.
    method : str
        "ours" or one of the runnable baselines that mark models, at the profile's PSNR.

    Returns
    -------
    list of dict
        One row a classifier: ``auc``, ``low``, ``high``, ``shift``, ``regions``.
    """
    features = _copies(path, profile_name, form, 2 * keys, seed, method)  # (1 + 2 keys, R, F)
    regions = features.shape[1]
    half = np.random.default_rng((seed, 3)).permutation(regions) < regions // 2
    rows = []
    for name, classifier in _classifiers(seed).items():
        score = np.empty(features.shape[:2])
        for asked in (half, ~half):
            _fit(classifier, [features[: 1 + keys, ~asked]])
            score[:, asked] = [_score(classifier, copy[asked]) for copy in features]
        asked_about = np.concatenate([score[:1], score[1 + keys :]])
        about = {"scene": Path(path).name, "method": method, "attacker": "insider", "form": form}
        rows.append({**about, "classifier": name, **_judged([asked_about])})
    return rows


def detect_as_stranger(paths: Sequence[str], profile_name: str, form: str, keys: int, seed: int) -> list[Row]:
    """Trained on all scenes but one, asked about that one, for each; fresh `keys` everywhere.

    Rows as of `detect_as_insider`, one a scene and classifier, and one of all scenes together.
    """
    if len(paths) < 2:
        raise InputError(f"a stranger learns from other scenes: at least 2 are needed, got {len(paths)}")
    features = [_copies(path, profile_name, form, keys, seed + 100 * n) for n, path in enumerate(paths)]
    rows = []
    for name, classifier in _classifiers(seed).items():
        scores = []
        for asked, path in enumerate(paths):
            _fit(classifier, [f for n, f in enumerate(features) if n != asked])
            scores.append(np.stack([_score(classifier, copy) for copy in features[asked]]))
            about = {"method": "ours", "attacker": "stranger", "form": form, "classifier": name}
            rows.append({"scene": Path(path).name, **about, **_judged(scores[-1:])})
        rows.append({"scene": "all", **about, **_judged(scores)})
    return rows


def _copies(path: str, profile_name: str, form: str, keys: int, seed: int, method: str = "ours") -> Float64:
    """(1 + keys, R, F) features of the unmarked model and of copies under different keys."""
    loaded, config = read_model(path), profile(profile_name, landmark_views=0)
    base = float_born(loaded.model, np.random.default_rng((seed, 4))) if form == "floats" else loaded.model
    regions, cameras = divide(base), make_rig(base, config.views, config.view_size, config.view_size)

    def marked(key: OwnerKey) -> GaussianModel:
        if method == "ours":
            return embed(base, key, original_sha256=loaded.sha256, bits=BITS, config=config).model
        message = derive_message(key, BITS, loaded.sha256.encode())
        return find_method(method).embed(base, key, message, config.psnr_db, cameras)[0]

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


def _classifiers(seed: int) -> dict[str, Any]:
    try:
        from sklearn.ensemble import RandomForestClassifier
        from sklearn.linear_model import LogisticRegression
        from sklearn.pipeline import make_pipeline
        from sklearn.preprocessing import StandardScaler
    except ModuleNotFoundError:
        raise InputError("the learned detector needs scikit-learn: pip install 'mark3dgs[evaluate]'") from None
    return {
        "logistic regression": make_pipeline(
            StandardScaler(), LogisticRegression(C=0.1, max_iter=2_000, class_weight="balanced")
        ),
        "random forest": RandomForestClassifier(
            200, min_samples_leaf=4, class_weight="balanced", random_state=seed, n_jobs=2
        ),
    }


def _fit(classifier: Any, known: Sequence[Float64]) -> None:
    """Anew, on scenes' features (1 + keys, R, F), the unmarked model first."""
    unmarked = np.concatenate([features[0] for features in known])
    marked = np.concatenate([features[1:].reshape(-1, features.shape[2]) for features in known])
    classifier.fit(np.concatenate([unmarked, marked]), np.repeat([0, 1], [len(unmarked), len(marked)]))


def _score(classifier: Any, features: Float64) -> Float64:
    return np.asarray(classifier.predict_proba(features)[:, 1])


def _judged(scores: Sequence[Float64]) -> dict[str, Any]:
    """AUC of regions (scenes' scores are (1 + keys, R), the unmarked model first), resampled by region.

    ``shift`` is the mean difference of marked and unmarked scores in standard deviations of the unmarked ones: what
    averaging over many regions could add up.
    """
    places = [(score[:1, r], score[1:, r]) for score in scores for r in range(score.shape[1])]
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
