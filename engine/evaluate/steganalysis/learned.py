"""Cells with a learned detector: can a classifier without the key tell marked models from unmarked ones?

Two attackers. The *stranger* has marked and unmarked models of other scenes. The *insider* is as strong as one can be
without the very original: of this scene itself he has the unmarked and several marked copies under other keys, but not
the regions he is asked about.
"""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from engine.errors import InputError
from engine.evaluate.baselines.methods import find_method
from engine.evaluate.marked_scene import bench_key
from engine.evaluate.steganalysis.attributes import Regions, divide, float_born, measure_regions
from engine.evaluate.steganalysis.roc import area, area_interval
from engine.evaluate.study import Row
from engine.formats import read_model
from engine.model import Float64, GaussianModel
from engine.pipeline.embedding import embed
from engine.pipeline.profiles import profile
from engine.pipeline.rigs import make_rig
from engine.sim.attacks import model_attack
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
    path : str
        Of a model.
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
    for name in _classifiers(seed):
        score = np.empty(features.shape[:2])
        for asked in (half, ~half):
            known = features[: 1 + keys, ~asked]
            model = _fit(name, known[0], known[1:].reshape(-1, known.shape[2]), seed)
            for copy in range(len(features)):
                score[copy, asked] = _score(model, features[copy, asked])
        asked_about = np.concatenate([score[:1], score[1 + keys :]])
        about = {"scene": Path(path).name, "method": method, "attacker": "insider", "form": form}
        rows.append({**about, "classifier": name, **_judged([asked_about])})
    return rows


def detect_as_stranger(paths: Sequence[str], profile_name: str, form: str, keys: int, seed: int) -> list[Row]:
    """Trained on all scenes but one, asked about that one, for each; fresh keys everywhere.

    Parameters
    ----------
    paths : sequence of str
        Of at least two models.
    profile_name, form, seed
        See `detect_as_insider`.
    keys : int
        Marked copies of each scene.

    Returns
    -------
    list of dict
        As `detect_as_insider`, one row a scene and classifier, and one of all scenes together.
    """
    if len(paths) < 2:
        raise InputError(f"a stranger learns from other scenes: at least 2 are needed, got {len(paths)}")
    features = [_copies(path, profile_name, form, keys, seed + 100 * n) for n, path in enumerate(paths)]
    rows = []
    for name in _classifiers(seed):
        scores = []
        for asked, path in enumerate(paths):
            others = [f for n, f in enumerate(features) if n != asked]
            unmarked = np.concatenate([f[0] for f in others])
            marked = np.concatenate([f[1:].reshape(-1, f.shape[2]) for f in others])
            model = _fit(name, unmarked, marked, seed)
            scores.append(np.stack([_score(model, copy) for copy in features[asked]]))
            about = {"method": "ours", "attacker": "stranger", "form": form, "classifier": name}
            rows.append({"scene": Path(path).name, **about, **_judged(scores[-1:])})
        rows.append({"scene": "all", **about, **_judged(scores)})
    return rows


def _copies(path: str, profile_name: str, form: str, keys: int, seed: int, method: str = "ours") -> Float64:
    """(1 + keys, R, F) features of the unmarked model and of copies under different keys."""
    loaded = read_model(path)
    base = float_born(loaded.model, np.random.default_rng((seed, 4))) if form == "floats" else loaded.model
    regions = divide(base)
    found = [_features(base, form, path, regions)]
    for number in range(keys):
        marked = _marked(base, loaded.sha256, profile_name, 1_000 * (seed + 1) + number, method)
        found.append(_features(marked, form, path, regions))
    return np.stack(found)


def _marked(base: GaussianModel, digest: str, profile_name: str, number: int, method: str) -> GaussianModel:
    key, config = bench_key(number), profile(profile_name, landmark_views=0)
    if method == "ours":
        return embed(base, key, original_sha256=digest, bits=BITS, config=config).model
    cameras = make_rig(base, config.views, config.view_size, config.view_size)
    message = derive_message(key, BITS, digest.encode())
    return find_method(method).embed(base, key, message, config.psnr_db, cameras)[0]


def _features(model: GaussianModel, form: str, path: str, regions: Regions) -> Float64:
    if form != "own format":
        return measure_regions(model, regions)
    stored = model_attack("convert").apply(model, _format(path))
    return measure_regions(_in_order(stored, model), regions)


def _format(path: str) -> str:
    known = ("compressed.ply", "splat", "spz", "sog", "ply")
    return next((name for name in known if path.endswith("." + name)), "ply")


def _in_order(stored: GaussianModel, model: GaussianModel) -> GaussianModel:
    """A format may order the Gaussians anew: back to the order that the regions know, by place and size."""
    from scipy.spatial import cKDTree

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


def _fit(name: str, unmarked: Float64, marked: Float64, seed: int) -> Any:
    is_marked = np.repeat([0, 1], [len(unmarked), len(marked)])
    return _classifiers(seed)[name].fit(np.concatenate([unmarked, marked]), is_marked)


def _score(model: Any, features: Float64) -> Float64:
    return np.asarray(model.predict_proba(features)[:, 1])


def _judged(scores: Sequence[Float64]) -> dict[str, Any]:
    """AUC of regions (scenes' scores are (1 + keys, R), the unmarked model first), resampled by region.

    ``shift`` is the mean difference of marked and unmarked scores in standard deviations of the unmarked ones: what
    averaging over many regions could add up.
    """
    places = [(score[:1, r], score[1:, r]) for score in scores for r in range(score.shape[1])]
    negative = np.concatenate([a for a, _ in places])
    positive = np.concatenate([b for _, b in places])
    low, high = area_interval(negative, positive, places)
    spread = max(float(negative.std()), 1e-12)
    return {
        "auc": area(negative, positive),
        "low": low,
        "high": high,
        "regions": len(places),
        "marked_scores": len(positive),
        "shift": float((positive.mean() - negative.mean()) / spread),
    }
