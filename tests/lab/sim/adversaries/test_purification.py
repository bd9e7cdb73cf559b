"""Clusters by density, and what is removed of them."""

from __future__ import annotations

import numpy as np
import pytest

from engine.errors import InputError
from engine.flows.views.camera_rig import make_rig
from engine.lab.sim.adversaries.purification import cluster_by_density
from engine.lab.sim.attacks import model_attack
from engine.lab.sim.model_placement import join
from engine.lab.sim.model_population import impact
from engine.model import GaussianModel, look_at
from tests.reference.density import cluster_by_density as by_the_book


def partition(labels: np.ndarray) -> set[frozenset[int]]:
    return {frozenset(np.flatnonzero(labels == k).tolist()) for k in np.unique(labels) if k >= 0}


@pytest.mark.parametrize("seed", range(6))
def test_the_fast_clusters_are_those_of_all_pairs(seed: int) -> None:
    rng = np.random.default_rng(seed)
    blobs = [rng.normal(rng.uniform(-4, 4, 2), rng.uniform(0.1, 0.6), (int(rng.integers(15, 40)), 2)) for _ in range(4)]
    points = np.concatenate([*blobs, rng.uniform(-6, 6, (20, 2))])
    fast = cluster_by_density(points, 4, 8, graph=len(points) - 1)
    assert partition(fast) == partition(by_the_book(points, 4, 8))
    assert len(partition(fast)) >= 2


def test_neighbors_alone_find_well_parted_blobs() -> None:
    rng = np.random.default_rng(1)
    centers = np.array([[0, 0, 0], [10, 0, 0], [0, 10, 0]], float)
    points = np.concatenate([c + rng.standard_normal((300, 3)) for c in centers] + [rng.uniform(-40, 40, (30, 3))])
    labels = cluster_by_density(points, 4, 40)
    truth = np.repeat(np.arange(3), 300)
    for k in range(3):
        assert np.unique(labels[:900][truth == k], return_counts=True)[1].max() > 200
    cores = [labels[:900][(truth == k) & (np.linalg.norm(points[:900] - centers[k], axis=1) < 1)] for k in range(3)]
    main = [np.bincount(c[c >= 0]).argmax() for c in cores]
    assert len(set(main)) == 3
    assert (labels[900:] < 0).mean() > 0.7


def test_few_points_and_equal_points_are_no_trouble() -> None:
    assert (cluster_by_density(np.zeros((3, 2)), 4, 8) == -1).all()
    assert len(cluster_by_density(np.zeros((50, 2)), 4, 8)) == 50
    with pytest.raises(InputError, match="graph >= neighbors"):
        cluster_by_density(np.zeros((50, 2)), 8, 8, graph=4)


def test_a_hidden_cluster_is_removed_and_the_object_stays(model: GaussianModel) -> None:
    """Faint Gaussians inside an opaque shell serve no view: they are what the method looks for."""
    rng = np.random.default_rng(3)
    middle = np.array([3.0, -1.0, 5.0])
    shell = model.with_(opacity_logits=np.full(500, 6.0), log_scales=model.log_scales + 0.7)
    means = middle + 0.1 * rng.standard_normal((100, 3))
    hidden = model.take(np.arange(100)).with_(means=means, opacity_logits=np.full(100, -3.0))
    both = join(shell, hidden)
    eyes = 6.0 * np.array([[1, 0, 0], [-1, 0, 0], [0, 0, 1], [0, 0, -1], [0.7, 0.7, 0], [0, -0.7, 0.7]])
    cameras = [look_at(middle + eye, middle, (0, -1, 0.01), 200.0, 128, 128) for eye in eyes]
    out = model_attack("purify").apply(both, 0.1, cameras=cameras)
    left = {row.tobytes() for row in out.means}
    assert sum(row.tobytes() in left for row in hidden.means) <= 5
    assert sum(row.tobytes() in left for row in shell.means) >= 300


def test_more_goes_as_the_threshold_rises_and_it_is_what_counts_least(model: GaussianModel) -> None:
    counts = [len(model_attack("purify").apply(model, s, rng=1)) for s in (0.01, 0.25, 1.0)]
    assert counts[0] >= counts[1] > counts[2] >= 1
    out = model_attack("purify").apply(model, 0.5, rng=1)
    kept = {row.tobytes() for row in out.means}
    weight = impact(model, make_rig(model, 8, 96, 96))
    stays = np.array([row.tobytes() in kept for row in model.means])
    assert weight[stays].mean() > 2 * weight[~stays].mean()
